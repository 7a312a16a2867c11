"""The differential-drive robot of host_sim/.

Data flow: path (a drive as the engine takes it), features -> diagnosis, where, advise (the report) -> told (what people read).
"""

from .diagnosis import diagnose, load, path_of, read
from .path import MOST, SETTLE, SMALLEST, Path, effects, name
from .told import Drive as Teller

__all__ = ["MOST", "SETTLE", "SMALLEST", "Path", "Teller", "diagnose", "effects", "load", "name", "path_of", "read"]
