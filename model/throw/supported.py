"""What a throw may combine: one table, which every door asks and the documents show.

Any die may have rounded corners, and any table may be tilted or oscillate; what is limited is what acts on which body.
"""

from __future__ import annotations

from enum import Enum

from .. import engine
from ..die import Die
from ..errors import InputError


class BodyKind(Enum):
    """What the inertia of a die is; the value is a sentence's end for the user."""

    CENTRED = "with one moment of inertia about its centroid"
    LOADED = "with one moment of inertia about a centre of mass beside its centroid"
    ASYMMETRIC = "with several moments of inertia"


class Action(Enum):
    """What acts on a die beside gravity and smooth impacts of one restitution; the value is its name for the user."""

    FRICTION = "friction"
    RESTITUTION_BY_SPEED = "a restitution by speed"
    FRICTION_BY_SPEED = "a friction by speed"
    DRAG = "air drag"


class Door(Enum):
    """What is asked of the model; the value is its name for the user."""

    THROW = "throws, odds, basins and predictions"
    DERIVATIVES = "derivatives of a throw, as a fit to one throw needs them"


_IMPACTS = frozenset({Action.FRICTION, Action.RESTITUTION_BY_SPEED, Action.FRICTION_BY_SPEED})
_NOTHING: frozenset[Action] = frozenset()
SUPPORTED: dict[Door, dict[BodyKind, frozenset[Action]]] = {
    Door.THROW: {BodyKind.CENTRED: _IMPACTS | {Action.DRAG}, BodyKind.LOADED: _IMPACTS, BodyKind.ASYMMETRIC: _IMPACTS},
    Door.DERIVATIVES: {
        BodyKind.CENTRED: frozenset({Action.FRICTION, Action.RESTITUTION_BY_SPEED, Action.DRAG}),
        BodyKind.LOADED: frozenset({Action.FRICTION, Action.RESTITUTION_BY_SPEED}),
        BodyKind.ASYMMETRIC: frozenset({Action.FRICTION, Action.RESTITUTION_BY_SPEED}),
    },
}
"""What may act on which body; several of them together, too. Drag acts at the centroid, so it would turn a die whose centre of
mass lies beside it: by up to 7° in 0.2 s at 3 m/s and 0.03 per m, for 1 mm in a cube of 16 mm. No kernel has that moment."""

_ACTIONS_OF_CODE = {
    engine.SMOOTH: _NOTHING,
    engine.COULOMB: frozenset({Action.FRICTION}),
    engine.SMOOTH_BY_SPEED: frozenset({Action.RESTITUTION_BY_SPEED}),
    engine.COULOMB_BY_SPEED: frozenset({Action.FRICTION, Action.RESTITUTION_BY_SPEED}),
    engine.COULOMB_FADING: frozenset({Action.FRICTION, Action.RESTITUTION_BY_SPEED, Action.FRICTION_BY_SPEED}),
}


def body_kind(die: Die) -> BodyKind:
    """What the inertia of a die is."""
    if die.is_spherical_top:
        return BodyKind.CENTRED
    return BodyKind.ASYMMETRIC if die.isotropic_inertia_kg_m2 is None else BodyKind.LOADED


def needs_asymmetric_kernels(kind: BodyKind, law: engine.Law) -> bool:
    """Whether the kernels of asymmetric dice follow a throw. For smooth impacts of a loaded die they prove more than those of one
    moment of inertia: that it spins for ever."""
    return kind is BodyKind.ASYMMETRIC or (kind is BodyKind.LOADED and law.code == engine.SMOOTH)


def refuse_unsupported(door: Door, kind: BodyKind, law: engine.Law, has_drag: bool = False) -> None:
    """Raise ValueError, naming what is too much, for a combination that `SUPPORTED` does not hold."""
    wanted = _ACTIONS_OF_CODE[law.code] | ({Action.DRAG} if has_drag else _NOTHING)
    allowed = SUPPORTED[door][kind]
    too_much = [action.value for action in Action if action in wanted - allowed]
    if not too_much:
        return
    others = " or ".join(action.value for action in Action if action in allowed)
    raise InputError(
        f"{' and '.join(too_much)} on a die {kind.value}: wanted smooth impacts, or {others}, for {door.value}"
    )


def support_table() -> str:
    """`SUPPORTED` as a table in Markdown."""
    rows = ["| die | " + " | ".join(door.value for door in Door) + " |", "| --- |" + " --- |" * len(Door)]
    for kind in BodyKind:
        cells = [", ".join(action.value for action in Action if action in SUPPORTED[door][kind]) for door in Door]
        rows.append(f"| {kind.value} | " + " | ".join(cells) + " |")
    return "\n".join(rows)
