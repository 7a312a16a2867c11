"""The sim-to-real gap of a flapping-wing flight: the simulated vehicle is held to the log by an observer.

Data flow: vehicle (the observer) -> baseline (healthy flights), vibration -> platforms/fwmav (a flight as the engine takes it) ->
prediction_errors (the engine) -> gap, where, advise -> diagnosis (the report) -> page (what people read).
"""

from . import page, words
from .diagnosis import diagnose, load

__all__ = ["diagnose", "load", "page", "words"]
