"""Your own robots, each a TOML file and a simulator."""

from .diagnosis import diagnose, path_of, read
from .path import Path
from .told import Own as Teller

__all__ = ["Path", "Teller", "diagnose", "path_of", "read"]
