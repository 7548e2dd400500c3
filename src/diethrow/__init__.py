"""Experiment against simulation for high-speed footage of thrown dice.

The whole way from a clip to a replay is `diethrow.commands.clip.analyze.analyze`; its steps are `diethrow.tracking`,
`diethrow.fitting`, `diethrow.model` and `diethrow.replay`. The names here are loaded when they are first used, so that
`import diethrow` stays quick.
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
    from .model.die import Die as Die
    from .model.die import Solid as Solid
    from .model.die import make_die as make_die
    from .model.laws import SmoothImpact as SmoothImpact
    from .model.throw import Flight as Flight
    from .model.throw import Impact as Impact
    from .model.throw import State as State
    from .model.throw import Throw as Throw
    from .model.throw import Until as Until
    from .model.throw import throw_die as throw_die
    from .tracking.camera import Camera as Camera
    from .tracking.track import Track as Track

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
    "model.laws": ("SmoothImpact",),
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
