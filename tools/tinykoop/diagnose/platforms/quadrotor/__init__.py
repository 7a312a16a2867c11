"""The quadrotor: what a flight asks of its rotors and how it answers, beside healthy flights.

Data flow: features (a flight, on average) -> baseline (healthy flights), causes (what may explain a difference) -> changes (what does)
-> path (predictions by the simulated vehicle) -> diagnosis, advise (the report) -> told, figures (what people read).
"""

from .diagnosis import diagnose, load, read
from .told import Flight as Teller

__all__ = ["Teller", "diagnose", "load", "read"]
