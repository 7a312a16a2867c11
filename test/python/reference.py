"""The paper written down a second time, to check lib/ and host_sim/ against.

Nothing here calls or imitates the C code: the recursions keep the information matrix R = P^-1,
never P, solve for the gain at every step, and count in decimals of DIGITS digits, so that against
float64 they are exact. The plant and the dictionaries are plain NumPy.
"""

from decimal import Context, Decimal, localcontext

import numpy as np

DT = 0.05  # s
STEPS = 5000
PHASES = (50.0, 100.0, 150.0, 200.0)  # s: slip from, friction from, both from, nominal again from
REGULATORS = ("none", "ef", "dz_cs", "dz_ks", "ct", "sift")
DICTIONARIES = ("poly_ddr", "rbf_ddr")
DIGITS = 36


# ---- plant: "Nominal Kinematics" and "Non-Stationary Disturbance" ---------------------------


def commands(steps=STEPS):
    """The paper's periodic open-loop commands (v, omega)."""
    k = np.arange(steps)
    return np.stack([1.5 + 0.3 * np.sin(0.1 * k), 0.6 * np.cos(0.08 * k)], axis=1)


def attenuation(v, w):
    """Pacejka's formula of the slip proxy 0.18 |v w|, cut to [0, 1]."""
    B, C, D, E = 10.0, 1.6, 0.11, 0.3
    bs = B * 0.18 * np.abs(v * w)
    return np.clip(D * np.sin(C * np.arctan(bs - E * (bs - np.arctan(bs)))), 0.0, 1.0)


def drag(v):
    """Stribeck's curve: static, Coulomb, viscous."""
    static, coulomb, viscous, scale = 0.40, 0.12, 0.08, 1.0
    return coulomb + (static - coulomb) * np.exp(-((v / scale) ** 2)) + viscous * np.abs(v)


def drive(u, slip, friction, x0=(0.0, 0.0, 0.0), dt=DT):
    """States (K+1, 3) of the robot. slip, friction: (K) booleans, where they act."""
    v, w = np.asarray(u, float).T
    loss = np.where(slip, attenuation(v, w), 0.0)
    forward, turn, sideways = v * (1 - 0.3 * loss), w * (1 - 0.7 * loss), np.sign(w) * 0.45 * v * loss
    braked = np.sign(turn) * np.maximum(np.abs(turn) - 0.1 * drag(turn), 0.0)
    turn = np.where(friction, braked, turn)
    forward = np.where(friction, forward * (1 - drag(forward)), forward)
    sideways = np.where(friction, sideways * (1 - drag(sideways)), sideways)
    heading = _accumulate(x0[2], turn * dt)
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    px = _accumulate(x0[0], (forward * cos - sideways * sin) * dt)
    py = _accumulate(x0[1], (forward * sin + sideways * cos) * dt)
    return np.stack([px, py, heading], axis=1)


def _accumulate(start, steps):
    return np.cumsum(np.concatenate([[start], steps]))


def phases(steps=STEPS):
    """(slip, friction) of the five phases."""
    phase = np.searchsorted(np.array(PHASES) / DT - 0.5, np.arange(steps))
    return (phase == 1) | (phase == 3), (phase == 2) | (phase == 3)


# ---- dictionaries: "Dictionary selection" ----------------------------------------------------


def lift(dictionary, x):
    """Psi of states x (K, 3)."""
    px, py, heading = x.T
    sin, cos = np.sin(heading), np.cos(heading)
    if dictionary == "poly_ddr":
        return np.stack([px, py, heading, px**2, py**2, sin, cos], axis=1)
    cx, cy = (c.ravel() for c in np.meshgrid(*[np.linspace(-3, 3, 4)] * 2, indexing="ij"))
    phi = np.exp(-((px[:, None] - cx) ** 2 + (py[:, None] - cy) ** 2) / (2 * 1.5**2))
    return np.column_stack([px, py, heading, phi, sin, cos, np.arctan2(sin, cos)])


# ---- recursions: eq. (4) and "Robust Covariance-Regulated Modifications" ----------------------

_exact = np.vectorize(Decimal, otypes=[object])


def _solve(R, right):
    """R^-1 right for a positive definite R, by elimination without square roots."""
    work = np.concatenate([R, right], axis=1)
    d = len(R)
    for i in range(d):
        factor = work[i + 1 :, i] / work[i, i]
        work[i + 1 :, i + 1 :] = work[i + 1 :, i + 1 :] - np.outer(factor, work[i, i + 1 :])
    solution = work[:, d:]
    for i in reversed(range(d)):
        solution[i] = (solution[i] - work[i, i + 1 : d] @ solution[i + 1 :]) / work[i, i]
    return solution


def learn(psi, u, regulator, lam=0.98, p0=100.0, delta=0.01, tau0=None, eps_sift=1e-10):
    """Theta, P and the predictions of psi[1:] that the exact recursion gives, as float64.

    Uses that the gain P_{k-1} zeta / (lambda + zeta' P_{k-1} zeta) is R^-1 zeta with
    R = lambda R_{k-1} + zeta zeta', and that the paper gives SIFt's R outright.
    """
    with localcontext(Context(prec=DIGITS)):
        lam, delta, eps_sift = Decimal(1 if regulator == "none" else lam), Decimal(delta), Decimal(eps_sift)
        psi, u = _exact(psi), _exact(u)
        N, d = psi.shape[1], psi.shape[1] + u.shape[1]
        eye = _exact(np.eye(d))
        R, tau0 = eye / Decimal(p0), Decimal(tau0 or d * p0)
        theta, predicted = _exact(np.zeros((N, d))), []
        for k in range(len(u)):
            zeta = np.concatenate([psi[k], u[k]])
            predicted.append(theta @ zeta)
            error = psi[k + 1] - predicted[-1]
            square = np.outer(zeta, zeta)
            if regulator == "sift":
                if zeta @ zeta < eps_sift:
                    continue
                Rz = R @ zeta
                renewed = R - np.outer(Rz, Rz) * ((1 - lam) / (zeta @ Rz)) + square
            else:
                renewed = R * lam + square
            gated = regulator in ("dz_cs", "dz_ks") and (error @ error).sqrt() <= delta
            if not (gated and regulator == "dz_ks"):
                theta = theta + np.outer(error, _solve(renewed, zeta[:, None])[:, 0])
            if not gated:
                R = renewed
            if regulator == "ct":
                R = R * (np.trace(_solve(R, eye)) / tau0)
        return theta.astype(float), _solve(R, eye).astype(float), np.array(predicted).astype(float)
