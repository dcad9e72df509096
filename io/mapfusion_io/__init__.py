"""Reading recordings and writing missions: MCAP, ROS 1 bags, rosbag2."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mapfusion_io.mission import Mission, MissionOptions, open_recording
    from mapfusion_io.output import MissionWriter, create_output

__all__ = ["Mission", "MissionOptions", "MissionWriter", "create_output", "open_recording"]

_MODULES = {
    "Mission": "mission",
    "MissionOptions": "mission",
    "MissionWriter": "output",
    "create_output": "output",
    "open_recording": "mission",
}


def __getattr__(name: str) -> object:
    """Imports a name when it is first asked for (PEP 562), as `mapfusion` does."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
