"""Parameters of the effects of a drive that a scan begins with: few, since each costs a simulation of the log."""

import numpy as np

RAYS = (0.12, 0.3, 0.6, 1.0, 1.6, 3.0, 6.0)  # of the usual size, at which a scan begins
FEW_RAYS = (0.3, 1.0, 3.0)  # the same of effects with several sizes
WIDE = 1.2  # m, the track of a large vehicle
SECONDS = (0.2, 0.6, 1.8)  # that a limited rate needs for a usual change of the command


def _quantiles(columns, quantiles):
    """(quantile, column) of the sizes of what moves."""
    moving = [np.abs(c)[np.abs(c) > 1e-9] for c in columns]
    return np.array([np.quantile(a, quantiles) if len(a) else np.zeros(len(quantiles)) for a in moving]).T


def _both_and_each(size):
    """A size for each command, and for each command alone."""
    return [v for v in ((size[0], size[1]), (size[0], 0.0), (0.0, size[1])) if max(v) > 1e-6]


def _limits(u, quantiles):
    return [start for size in _quantiles(u.T, quantiles) for start in _both_and_each(size)]


def _few_limits(u, both, each):
    """At quantiles `both` of the commands together, and at quantile `each` alone."""
    alone = _both_and_each(_quantiles(u.T, (each,))[0])
    return [tuple(size) for size in _quantiles(u.T, both) if max(size) > 1e-6] + [start for start in alone if min(start) == 0]


def _rims(u, quantiles, outer, usual):
    """At quantiles of the speeds of the rims, or of the faster wheel if `outer`, with the usual track and with a wide one."""
    out = []
    for track in (usual[1], WIDE):
        rims = np.abs(np.stack([u[:, 0] - u[:, 1] * track / 2, u[:, 0] + u[:, 1] * track / 2], 1))
        speeds = rims.max(1) if outer else rims.ravel()
        out += [(size, track) for (size,) in _quantiles([speeds], quantiles) if size > 1e-6]
    return out


def _rates(u):
    """Limits of the rate by how long a usual change of the command then takes."""
    sizes = np.std(u, axis=0)
    return [tuple(sizes / s) for s in SECONDS] + [v for v in _both_and_each(sizes / SECONDS[1]) if min(v) == 0]


def _load(u, usual):
    """A usual sideways load |v omega| of the drive."""
    load = np.abs(u[:, 0] * u[:, 1])
    return float(np.median(load[load > 1e-6])) if (load > 1e-6).any() else usual


def _slips(usual, u, s0):
    """Of a curve of the load, whose size is parameter s0, after the shares: usual or large, early or late, inwards or outwards."""
    starts = []
    for size, load, inward in ((1, 1, 1), (3, 1, 1), (3, 3, 1), (3, 1, -1)):
        start = usual.copy()
        start[:s0] *= size
        start[s0 - 1] *= inward
        start[s0] = load * _load(u, usual[s0])
        starts.append(start)
    return starts


def _own(name, usual, u):
    """Of effects that need more than their usual parameters; None of others."""
    match name:
        case "saturation":
            return _limits(u, (0.97, 0.9, 0.75, 0.5, 0.3))
        case "saturation_soft":
            return [(*size, usual[2]) for size in _few_limits(u, (0.95, 0.6), 0.75)]
        case "wheel_saturation":
            return _rims(u, (0.9, 0.65), True, usual)
        case "acceleration_limit":
            return _rates(u)
        case "dead_band":
            return _limits(u, (0.05, 0.12, 0.2, 0.3, 0.45))
        case "dead_zone_shifted":
            return _few_limits(u, (0.05, 0.2), 0.12)
        case "wheel_dead_band":
            return _rims(u, (0.1, 0.3), False, usual)
        case "pacejka_slip":
            return [usual * (1, 1, s, 1, 1) for s in (0.3, 1.0, 3.0)]
        case "slip_general":
            return _slips(usual, u, 3)
        case "slip_saturating":
            return _slips(usual, u, 2)
        case "stribeck_friction":
            return [usual * s for s in (0.3, 1.0, 1.6)]
        case "friction_coulomb":
            return [usual, usual * 3, usual * (1, 0), usual * (0, 1)]
        case "friction_general":
            return [usual * s for s in ((0.4, 0.4, 1, 1, 1), (1, 1, 1, 1, 1), (0.2, 2, 1, 1, 1))]
        case "backlash_angle":
            return [usual * s for s in ((0.5, 0), (2, 0), (0, 1), (1, 1))]
        case "second_order_lag":
            return [usual * s for s in ((0.5, 0.7), (1, 1.2), (2, 0.7), (3, 1.2))]
        case "speed_lag" | "yaw_lag":
            return [usual * r for r in FEW_RAYS]


def starts(name, spec, u, linear):
    """Vectors of parameters for commands u (K, 2), inside their bounds."""
    usual = np.array([p.usual for p in spec])
    found = list(np.diag(usual)) if linear else _own(name, usual, u)
    if found is None:
        signs = (1, -1) if spec[0].low < 0 else (1,)
        found = [usual * s * r for s in signs for r in RAYS]
    return tuple(dict.fromkeys(tuple(float(min(max(v, p.low), p.high)) for v, p in zip(start, spec)) for start in found))
