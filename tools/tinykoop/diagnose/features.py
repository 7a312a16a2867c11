"""A model without physics: velocity errors of the body as generic functions of command, heading, time and place.

It answers what no list of effects can: whether something systematic is left, on what it depends, and
how large it is. Columns are linear in their coefficients: small errors of velocity, summed along the path.
"""

import numpy as np
from scipy import linalg, ndimage, special

ROWS_EACH, LEAST = 10, 120  # values that a column must be worth; degrees of freedom that any log counts for
INDEPENDENT = 1e-6  # least share of the largest eigenvalue of columns that are not combinations of others
SMOOTH = 25  # rows
BLOCKS = 6  # of time, for errors that come and go
POSITION, HEADING = slice(0, 2), slice(2, 3)
CHANNELS = ("longitudinal", "lateral", "heading")


def _scaled(values):
    """To unit RMS; a feature that hardly moves is left out by its zero."""
    size = np.sqrt(np.mean(values**2))
    return values / size if size > 1e-9 else np.zeros_like(values)


def _after(u, seconds, dt):
    """What a first-order lag is behind the command."""
    keep = np.exp(-dt / seconds)
    recursion = np.stack([np.ones(len(u)), np.full(len(u), -keep)])
    return linalg.solve_banded((1, 0), recursion, np.vstack([u[:1], (1 - keep) * u[:-1]])) - u


def functions(u, pose, dt):
    """{name: (values (K), channels it acts on)}; names group by what the error depends on."""
    v, w = u.T
    K = len(u)
    t = np.linspace(-1, 1, K)
    one = np.ones(K)
    v_s, w_s = np.std(v) + np.abs(v).mean() + 1e-9, np.std(w) + np.abs(w).mean() + 1e-9
    a, b = v / v_s, w / w_s
    every = (0, 1, 2)
    # smooth: a feature must not carry the noise that it is to be told from
    pose = ndimage.uniform_filter1d(np.column_stack([pose[:, :2], np.unwrap(pose[:, 2])]), SMOOTH, axis=0)
    theta = pose[:, 2]
    # in the order in which a short log can afford them
    table = {"constant": (one, every), "v": (a, every), "omega": (b, every), "v omega": (a * b, every)}
    table |= {"heading, sine": (np.sin(theta), every), "heading, cosine": (np.cos(theta), every)}
    for seconds in (0.3, 2 * dt, 1.0):
        behind = _after(np.stack([a, b], 1), seconds, dt)
        table[f"change of v, {seconds:.2g} s"] = (behind[:, 0], (0, 2))
        table[f"change of omega, {seconds:.2g} s"] = (behind[:, 1], every)
    table |= {"v^2": (a * np.abs(a), every), "omega^2": (b * np.abs(b), every)}
    table |= {"time": (t, every), "time v": (t * a, every), "time omega": (t * b, every)}
    table |= {"|v|": (np.abs(a), every), "|omega|": (np.abs(b), every), "v |omega|": (a * np.abs(b), every)}
    table |= {"v^3": (a**3, (0, 2)), "omega^3": (b**3, (0, 2))}
    table |= {"v omega^2": (a * b * b, (0, 1)), "v^2 omega": (a * a * b, (1, 2))}
    for name, c in (("v", a), ("omega", b)):
        small = np.abs(c) < 0.5 * np.median(np.abs(c)) + 1e-9
        table[f"small {name}"] = (c * small, (0, 2))
        table[f"sign of {name}"] = (np.sign(c), (0, 2))
    for i in range(BLOCKS - 1):
        inside = ((t + 1) / 2 * BLOCKS).astype(int) == i
        table[f"block v {i}"] = (inside * a, (0, 1))
        table[f"block omega {i}"] = (inside * b, (1, 2))
    place = pose[:, :2] - pose[:, :2].mean(0)
    place = place / (place.std() + 1e-9)
    for axis, name in enumerate("xy"):
        table[f"place v {name}"] = (place[:, axis] * a, (0, 1))
        table[f"place omega {name}"] = (place[:, axis] * b, (2,))
    return table


def dependence(name):
    """The group a feature's name belongs to, for words."""
    for word in ("change", "heading", "time", "block", "place", "small", "sign"):
        if name.startswith(word):
            return {
                "block": "time",
                "small": "small commands",
                "sign": "sign of the command",
                "change": "changes of the command",
            }.get(word, word)
    return name


def integrate(pieces, values, channels):
    """Residuals (F, S, L, 3) that velocity errors values (F, S, L) (m/s, rad/s) make, each in its channel of `channels` (F)."""
    rows, dt = pieces.rows, pieces.log.dt
    x0 = pieces.start_pose
    heading = pieces.log.x[rows][..., 2] - x0[:, None, 2]
    c, s = np.cos(heading), np.sin(heading)
    # in the start's axes: the way already gone, by measurement
    across, along = -pieces.turns[..., 0, 2], pieces.turns[..., 1, 2]
    d_across, d_along = (np.diff(way, axis=1, append=way[:, -1:]) for way in (across, along))
    going_on = pieces.inside * dt
    going_on[:, -1] = 0
    out = np.zeros((len(values), *rows.shape, 3))

    def summed(increments):
        total = np.zeros_like(increments)
        np.cumsum(increments[..., :-1], axis=-1, out=total[..., 1:])
        return total

    for channel in range(3):
        chosen = np.asarray(channels) == channel
        step = values[chosen] * going_on
        if channel == 0:
            moved = summed(step * c), summed(step * s), 0
        elif channel == 1:
            moved = summed(-step * s), summed(step * c), 0
        else:
            turn = summed(step)
            middle = turn + 0.5 * step
            moved = summed(-middle * d_across), summed(middle * d_along), turn
        for axis, part in enumerate(moved):
            out[chosen, ..., axis] = np.where(pieces.inside, part, 0)
    return out


def raw_columns(pieces):
    """Names [(feature, channel)] and columns (F, S, L, 3), not whitened; made once while starts of the pieces stay as they are."""
    if pieces.raw is None:
        pieces.raw = _raw_columns(pieces)
    return pieces.raw


def _in_pieces(pieces):
    """{name: (scaled values in the rows of the pieces (S, L), channels)} of what moves at all; made once, since starts have no say."""
    if pieces.features is None:
        u = pieces.platform.commands(pieces.log.u)
        table = functions(u, pieces.log.x, pieces.log.dt)
        scaled = ((name, _scaled(values), channels) for name, (values, channels) in table.items())
        pieces.features = {name: (values[pieces.rows], channels) for name, values, channels in scaled if values.any()}
    return pieces.features


def _raw_columns(pieces):
    names, used = [], []
    for name, (values, channels) in _in_pieces(pieces).items():
        if ROWS_EACH * (len(names) + len(channels)) <= max(pieces.degrees, LEAST):
            used.extend(values for _ in channels)
            names.extend((name, channel) for channel in channels)
    return names, integrate(pieces, np.array(used), [channel for _, channel in names])


class _Basis:
    """The generic model's columns in pieces as they are now: raw (F, S, L, 3), and white orthonormal (n, F')."""

    def __init__(self, pieces):
        self.names, self.raw = raw_columns(pieces)
        F = pieces.whiten(self.raw).reshape(len(self.raw), -1)
        size = np.linalg.norm(F, axis=1)
        keep = size > 1e-9 * size.max()
        unit = F[keep] / size[keep, None]
        values, vectors = np.linalg.eigh(unit @ unit.T)
        good = values > INDEPENDENT * values[-1]
        self.spread = np.zeros((len(F), good.sum()))  # coefficients from white amplitudes
        self.spread[keep] = vectors[:, good] / np.sqrt(values[good]) / size[keep, None]
        self.white = self.spread.T @ F
        self.single = F / np.maximum(size, 1e-300)[:, None]


def basis_of(pieces):
    """The basis, made once while noise and starts of the pieces stay as they are."""
    if pieces.generic is None:
        pieces.generic = _Basis(pieces)
    return pieces.generic


class Generic:
    """The generic model fitted to what `active` leaves of the pieces.

    residual, left, part (S, L, 3): residuals, without, and explained by it; cost: sum of squares that remains, whitened;
    gain, count: what its columns take away, and how many they are.
    """

    def __init__(self, pieces, active=()):
        basis = basis_of(pieces)
        self.names, self.raw, self._spread = basis.names, basis.raw, basis.spread
        r = pieces.residual(active)
        w = pieces.whiten(r).ravel()
        amplitudes = basis.white @ w
        self.coefficients = basis.spread @ amplitudes
        self._alone = (basis.single @ w) ** 2
        self.part = np.tensordot(self.coefficients, self.raw, 1)
        self.left, self.residual = r - self.part, r
        self.gain, self.count = float(amplitudes @ amplitudes), len(amplitudes)
        self.cost = float(w @ w) - self.gain
        self.free = pieces.degrees - self.count
        self._inside, self._rho = pieces.inside, max(pieces.noise.rho_p, pieces.noise.rho_t, 0.0)

    @property
    def scale(self):
        """Variance that is left per degree of freedom: 1 if the noise is known well."""
        return max(self.cost, 1e-12) / max(self.free, 1)

    def significance(self):
        """Probability of such a gain if nothing but noise is left.

        Slow noise is known from fewer values than there are: rows that go along with their neighbours count less.
        """
        known = max(self.free * (1 - self._rho) / (1 + self._rho), 1)
        return float(special.fdtrc(self.count, known, self.gain / self.count / self.scale))

    def gap(self, H, channels=POSITION):
        """RMS error (m, or rad) after H rows, which most pieces must reach, that the generic model finds.

        What noise feigns is taken off.
        """
        at = self._inside[:, H]
        if not at.any():
            return 0.0
        error = self.raw[:, at, H, channels]
        found = np.tensordot(self.coefficients, error, 1)
        feigned = self.scale * (np.tensordot(self._spread.T, error, 1) ** 2).sum(0)
        return float(np.sqrt(max((found**2 - feigned).sum(-1).mean(), 0)))

    def depends(self):
        """{(what, channel): share of the gain that this feature takes by itself}, the largest of each group first."""
        alone = {}
        for (name, channel), gain in zip(self.names, self._alone):
            group = dependence(name), CHANNELS[channel]
            alone[group] = max(alone.get(group, 0.0), float(gain / max(self.gain, 1e-12)))
        return dict(sorted(alone.items(), key=lambda item: -item[1]))
