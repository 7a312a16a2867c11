"""The vehicle from above, as SVG: what each rotor is asked for beside healthy flights, and where weights are."""

import numpy as np

from .... import bridge
from ...report.figures import WIDTH, note, stroke, svg
from .causes import PAYLOAD, SLUNG
from .features import ROTORS

HEIGHT, CENTRE = 336, (WIDTH / 2, 152)
REACH, RADIUS = 92, 38  # px, from the centre to a rotor along an axis; of a rotor
FRONT = {1: (1, 1), 2: (-1, 1), 3: (-1, -1), 4: (1, -1)}  # (ahead, right) of each rotor


def above(result, effects, caption):
    """(caption, figure)."""
    changes = result.more["changes"]
    healthy, now = np.mean([one.rotors for one in changes.healthy], axis=0), changes.flight.rotors
    parts = [stroke(CENTRE[0] - REACH * s, CENTRE[1] - REACH, CENTRE[0] + REACH * s, CENTRE[1] + REACH, "grid") for s in (1, -1)]
    weak = {effect["name"]: effect for effect in effects}
    for i in ROTORS:
        x, y = _at(*FRONT[i])
        found = weak.get(f"rotor{i}_thrust")
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{RADIUS}" class="{"bar-after" if found else "bar-floor"}"/>')
        parts.append(note(x, y - RADIUS - 6, f"M{i}", "strong", "middle"))
        side, anchor = (RADIUS + 6, "start") if FRONT[i][1] > 0 else (-RADIUS - 6, "end")
        asked = f"{100 * (now[i - 1] - healthy[i - 1]):+.1f} %" if np.isfinite(now[i - 1]) else "-"
        parts.append(note(x + side, y, asked.replace("-", "\N{MINUS SIGN}"), "strong" if found else "", anchor))
        if found:
            low, high = (100 * v for v in found["params_ci95"]["a"])
            told = f"thrust {low:+.0f} to {high:+.0f} %".replace("-", "\N{MINUS SIGN}")
            parts.append(note(x, y + RADIUS + 17, told, "", "middle"))
    for name in (PAYLOAD, SLUNG):
        if name in weak:
            parts.append(_weight(weak[name], result.path.vehicle))
    parts.append(note(CENTRE[0], 14, "front", "label", "middle"))
    parts.append(note(6, HEIGHT - 6, "Numbers: request beside healthy flights, in % of full thrust", "label"))
    return caption, svg(HEIGHT, caption, *parts)


def _at(ahead, right):
    """px of a place, in levers of a rotor."""
    return CENTRE[0] + REACH * right, CENTRE[1] - REACH * ahead


def _weight(effect, vehicle):
    """A square where the weight is, within the figure."""
    lever = bridge.quadrotor_vehicle(vehicle)["arm"] * np.sqrt(0.5)
    ahead, left = (float(np.clip(effect["params"][key] / lever, -1.4, 1.4)) for key in ("x", "y"))
    x, y = _at(ahead, -left)
    text = f"{1000 * effect['params']['mass']:.2g} g"
    return f'<rect x="{x - 9:.1f}" y="{y - 9:.1f}" width="18" height="18" class="bar-before"/>' + note(x + 14, y + 5, text, "strong")
