"""The throw file: one throw to simulate.

`read_plan` turns a throw.toml into values of the model: a die, an impact law, a release state and an end. Orientation is a
quaternion or the paper's Euler angles; angular velocity is given in world axes or in body axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from ..model.die import Die
from ..model.errors import InputError
from ..model.laws import MAX_DRAG_PER_M, CoulombImpact, SmoothImpact, checked_drag
from ..model.laws import Table as ModelTable
from ..model.rotations import matrix_from_quat, quat_from_euler
from ..model.throw import State, checked_release
from ..model.world import GRAVITY_M_S2
from .die_and_table import ESTIMATE, DieTable, Table, TableTable, WorldTable, die_from, table_from
from .settings import (
    FilesBeside,
    NotNegative,
    Positive,
    PositiveInt,
    TomlTable,
    Vector3,
    Vector4,
    read_toml,
    refuse,
    validate,
)

Array = NDArray[np.float64]

UNIT_TOLERANCE = 1e-4
"""A quaternion written with four decimals passes, and is normalised."""
MAX_DISTANCE_M = 100.0
"""From the origin to a release; beyond it the position is in another unit."""
TOUCH_TOLERANCE = 1e-12
"""Of the circumscribed radius: how far rounding may leave the lowest corner of a die on the table below it."""


@dataclass(frozen=True)
class Plan:
    """One throw to simulate, as its file describes it."""

    path: Path
    text: str
    """The file as it was read."""
    die: Die
    table: Table
    chi: float
    mu: float
    """Coefficient of friction; 0 for the paper's smooth impact."""
    release: State
    until_s: float | None
    """[s] since release; None for no such limit."""
    until_impacts: int | None
    fps: float
    """Rows of simulated.csv a second."""
    mesh_path: Path | None = None
    """The file of the die's mesh."""
    drag_per_m: float = 0.0
    """k of the air drag, v' = g - k |v| v; 0 for a vacuum."""

    @property
    def inputs(self) -> tuple[Path, ...]:
        """The files that describe the throw."""
        return (self.path,) if self.mesh_path is None else (self.path, self.mesh_path)

    @property
    def law(self) -> SmoothImpact | CoulombImpact:
        """The impact law: with friction only where the file gives it."""
        return CoulombImpact(self.chi, self.mu) if self.mu else SmoothImpact(self.chi)

    @property
    def model_table(self) -> ModelTable:
        """The table as a value of the model."""
        return self.table.in_model


def read_plan(path: Path) -> Plan:
    """The throw in a TOML file. Raises SceneError, one sentence a mistake."""
    path = Path(path)
    data, text = read_toml(path)
    checked = validate(_PlanFile, data, path)
    table = table_from(checked.table or TableTable(surface="", motion=None), checked.world)
    if checked.die.corner_radius_m == ESTIMATE:
        raise refuse(
            path,
            "die.corner_radius_m",
            ESTIMATE,
            "a simulated throw has no pictures to estimate from; wanted metres",
        )
    die, mesh = die_from(checked.die, path, FilesBeside(path, allow_outside=True))
    release = _release(checked.initial, die, path)
    until = checked.until
    plan = Plan(
        path,
        text,
        die,
        table,
        checked.law.chi,
        checked.law.mu or 0.0,
        release,
        until.time_s,
        until.impacts,
        checked.output.fps,
        mesh,
        checked.world.drag_per_m,
    )
    try:
        checked_release(die, release, plan.model_table)
    except ValueError as error:
        raise refuse(path, "initial.position_m", release.position_m, f"{error}") from None
    return plan


def _restitution(value: float) -> float:
    if not 0 <= value <= 1:
        raise InputError("outside 0 to 1")
    return value


def _within_a_turn(values: list[float]) -> list[float]:
    if any(abs(value) > 2 * np.pi for value in values):
        raise InputError("more than a turn")
    return values


class _LawTable(TomlTable):
    chi: Annotated[float, AfterValidator(_restitution)] = Field(description="the restitution coefficient, from 0 to 1")
    mu: NotNegative | None = Field(None, description="the coefficient of friction, 0 or more")


class _InitialTable(TomlTable):
    position_m: Vector3 = Field(description="3 numbers in metres, the centre of the die")
    euler_rad: Annotated[Vector3, AfterValidator(_within_a_turn)] | None = Field(
        None, description="3 numbers, psi, theta, phi in radians, within one turn"
    )
    quaternion_wxyz: Vector4 | None = Field(None, description="4 numbers, a unit quaternion w x y z, body to world")
    velocity_m_s: Vector3 = Field(description="3 numbers in metres per second")
    omega_body_rad_s: Vector3 | None = Field(None, description="3 numbers in radians per second, body axes")
    omega_rad_s: Vector3 | None = Field(None, description="3 numbers in radians per second, world axes")


class _UntilTable(TomlTable):
    time_s: Positive | None = Field(None, description="a time since release in seconds, above 0")
    impacts: PositiveInt | None = Field(None, description="a number of impacts, a whole number above 0")


class _AirTable(WorldTable):
    """`[world]` of a throw: a fit finds the drag by itself, a simulation has to be given it."""

    drag_per_m: Annotated[float, AfterValidator(checked_drag)] = Field(
        0.0, description=f"k of the air drag -k |v| v in 1/m, from 0 to {MAX_DRAG_PER_M:g}; a light die has 0.03"
    )


class _OutputTable(TomlTable):
    fps: Positive = Field(1500.0, description="rows of simulated.csv a second, a number above 0")


class _PlanFile(TomlTable):
    die: DieTable = Field(description="a [die] table with shape, its lengths (edge_m) and mass_kg")
    table: TableTable | None = Field(None, description='a [table] table, for example surface = "wood"')
    law: _LawTable = Field(description="a [law] table with chi")
    initial: _InitialTable = Field(description="an [initial] table with position_m, velocity_m_s, orientation and spin")
    until: _UntilTable = Field(
        _UntilTable(time_s=None, impacts=None), description="an [until] table with time_s or impacts"
    )
    world: _AirTable = Field(
        _AirTable(gravity_m_s2=GRAVITY_M_S2, drag_per_m=0.0),
        description="a [world] table with gravity_m_s2 or drag_per_m",
    )
    output: _OutputTable = Field(_OutputTable(fps=1500.0), description="an [output] table with fps")


def _release(table: _InitialTable, die: Die, path: Path) -> State:
    position = np.array(table.position_m, float)
    quaternion = _orientation(table, path)
    rotation = matrix_from_quat(quaternion)
    if float(np.abs(position).max()) > MAX_DISTANCE_M:
        guess = f"did you mean {(position * 1e-3).tolist()}?"
        raise refuse(
            path, "initial.position_m", position, f"wanted metres, within {MAX_DISTANCE_M:g} m of the origin; {guess}"
        )
    lowest = float((position + die.solid.vertices @ rotation.T)[:, 2].min())
    if lowest < -TOUCH_TOLERANCE * die.solid.circumradius:
        wanted = f"the lowest corner is {-lowest:.4g} m below the table; wanted every corner at z >= 0"
        raise refuse(path, "initial.position_m", position, wanted)
    return State(0.0, position, quaternion, np.array(table.velocity_m_s, float), _spin(table, rotation, path))


def _orientation(table: _InitialTable, path: Path) -> Array:
    if (table.euler_rad is None) == (table.quaternion_wxyz is None):
        given = "both" if table.euler_rad else "neither"
        raise refuse(path, "initial.euler_rad and initial.quaternion_wxyz", given, "wanted one of the two")
    if table.quaternion_wxyz is None:
        return quat_from_euler(table.euler_rad or [0.0, 0.0, 0.0])
    quaternion = np.array(table.quaternion_wxyz, float)
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        wanted = f"wanted a unit quaternion w x y z, this one has length {length:.6g}"
        raise refuse(path, "initial.quaternion_wxyz", quaternion, wanted)
    return quaternion / length


def _spin(table: _InitialTable, rotation: Array, path: Path) -> Array:
    if (table.omega_rad_s is None) == (table.omega_body_rad_s is None):
        given = "both" if table.omega_rad_s else "neither"
        raise refuse(path, "initial.omega_rad_s and initial.omega_body_rad_s", given, "wanted one of the two")
    if table.omega_rad_s is not None:
        return np.array(table.omega_rad_s, float)
    return np.asarray(rotation @ np.array(table.omega_body_rad_s, float))
