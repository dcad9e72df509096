"""Fusing the occupancy grids of several robots whose frames are unknown to each other."""

from importlib import import_module
from typing import TYPE_CHECKING

from mapfusion.version import __version__

if TYPE_CHECKING:
    from mapfusion.config import FusionConfig, Prior, ReplayConfig
    from mapfusion.errors import ConfigError, LogReadError, LogWriteError, MapfusionError, MissionError
    from mapfusion.fusion import fuse_pair
    from mapfusion.grid import OccupancyGrid
    from mapfusion.pipeline import replay
    from mapfusion.result import PairFusion
    from mapfusion.steps import FusionStep, GridEvent, RobotEvent
    from mapfusion.transform import SE2

__all__ = [
    "SE2",
    "ConfigError",
    "FusionConfig",
    "FusionStep",
    "GridEvent",
    "LogReadError",
    "LogWriteError",
    "MapfusionError",
    "MissionError",
    "OccupancyGrid",
    "PairFusion",
    "Prior",
    "ReplayConfig",
    "RobotEvent",
    "__version__",
    "fuse_pair",
    "replay",
]

# Names are imported when they are first asked for (PEP 562): numpy and OpenCV take longer to load than the command
# line may take to print its help.
_MODULES = {
    "SE2": "transform",
    "ConfigError": "errors",
    "FusionConfig": "config",
    "FusionStep": "steps",
    "GridEvent": "steps",
    "LogReadError": "errors",
    "LogWriteError": "errors",
    "MapfusionError": "errors",
    "MissionError": "errors",
    "OccupancyGrid": "grid",
    "PairFusion": "result",
    "Prior": "config",
    "ReplayConfig": "config",
    "RobotEvent": "steps",
    "fuse_pair": "fusion",
    "replay": "pipeline",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
