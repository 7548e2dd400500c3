"""Experiment against simulation for high-speed footage of thrown dice.

The whole way from a clip to a replay is `diethrow.analyze.analyze`; its steps are `diethrow.tracking`,
`diethrow.fitting`, `diethrow.model` and `diethrow.replay`. The names here are loaded when they are first used, so that
`import diethrow` stays quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .model.impacts import SmoothImpact
    from .model.motion import Flight, Impact, State, Throw
    from .model.simulate import Until, throw_die
    from .model.solids import Die, Solid, make_die
    from .plan import Plan, read_plan
    from .scene import Scene, read_scene
    from .settings import SceneError
    from .tracking.camera import Camera
    from .tracking.track import Track

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "Die",
    "Flight",
    "Impact",
    "Plan",
    "Scene",
    "SceneError",
    "SmoothImpact",
    "Solid",
    "State",
    "Throw",
    "Track",
    "Until",
    "make_die",
    "read_plan",
    "read_scene",
    "throw_die",
]

_NAMES_OF = {
    "model.impacts": ("SmoothImpact",),
    "model.motion": ("Flight", "Impact", "State", "Throw"),
    "model.simulate": ("Until", "throw_die"),
    "model.solids": ("Die", "Solid", "make_die"),
    "plan": ("Plan", "read_plan"),
    "scene": ("Scene", "read_scene"),
    "settings": ("SceneError",),
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
