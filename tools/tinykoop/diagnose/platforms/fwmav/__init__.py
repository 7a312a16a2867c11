"""The flapping-wing vehicle of host_sim/: the simulated one is held to a flight by an observer.

Data flow: vehicle (the observer) -> baseline (healthy flights), vibration -> path (a flight as the engine takes it) ->
diagnosis, where, advise (the report) -> told, figures (what people read).
"""

from .diagnosis import diagnose, load, path_of, read
from .told import Flight as Teller

__all__ = ["Teller", "diagnose", "load", "path_of", "read"]
