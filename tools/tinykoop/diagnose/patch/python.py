"""A Python function that does to the commands of a drive what the effects do, for your own simulator."""

from . import snippet

# In the order in which they act (host_sim/effects.c).
LINES = {
    "saturation": "v, omega = _limited(v, {v_max!r}), _limited(omega, {w_max!r})",
    "transport_delay": "v, omega = _delayed(v, dt, {delay!r}), _delayed(omega, dt, {delay!r})",
    "dead_band": "v, omega = np.where(np.abs(v) < {v_db!r}, 0.0, v), np.where(np.abs(omega) < {w_db!r}, 0.0, omega)",
    "actuator_lag": "v, omega = _lagged(v, dt, {tau!r}), _lagged(omega, dt, {tau!r})",
    "speed_gain": "v = v * (1 + {a!r})",
    "yaw_gain": "omega = omega * (1 + {b!r})",
    "wheel_asymmetry": "omega = omega + {c!r} * v",
    "yaw_bias": "omega = omega + {d!r}",
}
HELPERS = {
    "_limited": '''def _limited(u, largest):
    """Limited to +-largest; 0: no limit."""
    return np.clip(u, -largest, largest) if largest else u
''',
    "_delayed": '''def _delayed(u, dt, delay):
    """The mean over each step of the command as it was `delay` seconds before."""
    t = np.arange(len(u)) * dt
    return np.interp(t - delay, t, u)
''',
    "_lagged": '''def _lagged(u, dt, tau):
    """The mean over each step of the command behind a first-order lag, which begins at rest."""
    out, state, gone = np.empty(len(u)), u[0], -np.expm1(-dt / tau)
    for k, command in enumerate(u):
        behind = state - command
        out[k] = command + behind * gone * tau / dt
        state -= behind * gone
    return out
''',
}


def patched(text, report, path):
    lines = snippet.lines(LINES, report, path)
    body = "\n".join(f"    {line}" for line in (*lines, "return v, omega"))
    about = '    """Commands (K,) every dt seconds as this robot executes them. Found by tinykoop diagnose."""'
    function = f"def executed(v, omega, dt):\n{about}\n{body}\n"
    return text + ("\n\n" if text else "") + "\n\n".join(["import numpy as np\n", *snippet.needed(HELPERS, lines), function])
