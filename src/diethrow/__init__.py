"""Experiment against simulation for high-speed footage of thrown dice.

    >>> import diethrow as dt
    >>> a = dt.analyze("data_samples/cube_wood/scene.toml")   # doctest: +SKIP
    >>> a.parameters, a.plot.heights()                        # doctest: +SKIP

`analyze` makes an `Analysis` from a scene and `load` one from a folder; `throw`, `odds` and `basins` are the model alone. The
stages are `diethrow.tracking`, `diethrow.fitting`, `diethrow.model` and `diethrow.replay`. The names here are loaded when they
are first used, so that `import diethrow` stays quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .files.plan import Plan as Plan
    from .files.plan import read_plan as read_plan
    from .files.scene import Scene as Scene
    from .files.scene import read_scene as read_scene
    from .files.settings import SceneError as SceneError
    from .interface import Analysis as Analysis
    from .interface import Basins as Basins
    from .interface import Odds as Odds
    from .interface import SimulatedThrow as SimulatedThrow
    from .interface import analyze as analyze
    from .interface import basins as basins
    from .interface import load as load
    from .interface import odds as odds
    from .interface import throw as throw
    from .interface import to_xarray as to_xarray
    from .model.die import Die as Die
    from .model.die import Solid as Solid
    from .model.die import make_die as make_die
    from .model.ensembles import Axis as Axis
    from .model.ensembles import PaperConditions as PaperConditions
    from .model.ensembles import UniformConditions as UniformConditions
    from .model.errors import DiethrowError as DiethrowError
    from .model.errors import InputError as InputError
    from .model.laws import CoulombImpact as CoulombImpact
    from .model.laws import FrictionBySpeed as FrictionBySpeed
    from .model.laws import RestitutionBySpeed as RestitutionBySpeed
    from .model.laws import SmoothImpact as SmoothImpact
    from .model.laws import Table as Table
    from .model.throw import Flight as Flight
    from .model.throw import Impact as Impact
    from .model.throw import State as State
    from .model.throw import Throw as Throw
    from .model.throw import Until as Until
    from .model.throw import throw_die as throw_die
    from .runs import RunError as RunError
    from .tracking.camera import Camera as Camera
    from .tracking.track import Track as Track

__version__ = "0.1.0"

__all__ = [
    "Analysis",
    "Axis",
    "Basins",
    "Camera",
    "CoulombImpact",
    "Die",
    "DiethrowError",
    "Flight",
    "FrictionBySpeed",
    "Impact",
    "InputError",
    "Odds",
    "PaperConditions",
    "Plan",
    "RestitutionBySpeed",
    "RunError",
    "Scene",
    "SceneError",
    "SimulatedThrow",
    "SmoothImpact",
    "Solid",
    "State",
    "Table",
    "Throw",
    "Track",
    "UniformConditions",
    "Until",
    "analyze",
    "basins",
    "load",
    "make_die",
    "odds",
    "read_plan",
    "read_scene",
    "throw",
    "throw_die",
    "to_xarray",
]

_NAMES_OF = {
    "interface": (
        *("Analysis", "analyze", "load", "to_xarray"),
        *("Basins", "Odds", "SimulatedThrow", "basins", "odds", "throw"),
    ),
    "runs": ("RunError",),
    "model.errors": ("DiethrowError", "InputError"),
    "model.ensembles": ("Axis", "PaperConditions", "UniformConditions"),
    "model.laws": ("CoulombImpact", "FrictionBySpeed", "RestitutionBySpeed", "SmoothImpact", "Table"),
    "model.throw": ("Flight", "Impact", "State", "Throw", "Until", "throw_die"),
    "model.die": ("Die", "Solid", "make_die"),
    "files.plan": ("Plan", "read_plan"),
    "files.scene": ("Scene", "read_scene"),
    "files.settings": ("SceneError",),
    "tracking.camera": ("Camera",),
    "tracking.track": ("Track",),
}
_HOME_OF = {name: module for module, names in _NAMES_OF.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'diethrow' has no attribute {name!r}")
    value = getattr(import_module(f".{_HOME_OF[name]}", __name__), name)
    globals()[name] = value
    return value
