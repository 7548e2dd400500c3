"""What scenes and throws say of the die, of the table, and of gravity where it stands.

TOML tables that both files have, and the values of the model that they become."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from ..model.die import MAX_CORNER_RADIUS_FRACTION, SHAPES, Die, make_die
from ..model.laws import Table as ModelTable
from ..model.world import GRAVITY_M_S2
from .settings import NotNegative, Positive, TomlTable, not_negative, refuse, unit_guess

MAX_EDGE_M = 1.0
"""Edge of a die; a longer one is in another unit."""
MIN_DENSITY_KG_M3 = 5.0
"""Of a die of foam; with a lower one a length or a mass is in another unit."""
MAX_DENSITY_KG_M3 = 25000.0
"""Above osmium; with a higher one a length or a mass is in another unit."""
MIN_INERTIA_SHARE = 1e-3
"""Of the moment of inertia with all the mass at the corners; a smaller one is in another unit."""
GRAVITY_RANGE_M_S2 = (0.1, 30.0)
"""From the fall of an aircraft on a parabola to that on the largest planet; beyond it the value is in another unit."""
ESTIMATE = "estimate"
"""Instead of a number: it is estimated from the pictures."""


@dataclass(frozen=True)
class Motion:
    """An oscillating table: z = amplitude sin(2π frequency t + phase)."""

    amplitude_m: float
    frequency_hz: float
    phase_rad: float


@dataclass(frozen=True)
class Table:
    """The table that the die falls on."""

    surface: str
    """Free text; `mirror` says that the table reflects."""
    motion: Motion | None = None
    gravity_m_s2: float = GRAVITY_M_S2
    """Where it stands."""

    @property
    def in_model(self) -> ModelTable:
        """The table as a value of the model."""
        if self.motion is None:
            return ModelTable(gravity_m_s2=self.gravity_m_s2)
        return ModelTable(
            amplitude_m=self.motion.amplitude_m,
            frequency_hz=self.motion.frequency_hz,
            phase_rad=self.motion.phase_rad,
            gravity_m_s2=self.gravity_m_s2,
        )


# --- the file, as TOML tables ---


def _known_shape(value: str) -> str:
    if value not in SHAPES:
        raise ValueError("unknown shape")
    return value


def _radius_or_estimate(value: float | str) -> float | str:
    if isinstance(value, str):
        if value != ESTIMATE:
            raise ValueError("no such word")
        return value
    return not_negative(value)


def _known_marks(value: str) -> str:
    if value not in ("pips", "numbers"):
        raise ValueError("unknown marks")
    return value


def _gravity(value: float) -> float:
    if not GRAVITY_RANGE_M_S2[0] <= value <= GRAVITY_RANGE_M_S2[1]:
        raise ValueError("out of range")
    return value


Radius = Annotated[float | str, AfterValidator(_radius_or_estimate)]


class _MotionTable(TomlTable):
    amplitude_m: NotNegative = Field(description="the amplitude in metres, 0 or more")
    frequency_hz: Positive = Field(description="the frequency in hertz, above 0")
    phase_rad: float = Field(0.0, description="the phase at t = 0 in radians")


class TableTable(TomlTable):
    """`[table]`, in scenes and throws alike."""

    surface: str = Field(description='the surface as text, for example "wood"; "mirror" for one that reflects')
    motion: _MotionTable | None = Field(None, description="a table {amplitude_m, frequency_hz, phase_rad}")


class WorldTable(TomlTable):
    """`[world]`, in scenes and throws alike."""

    gravity_m_s2: Annotated[float, AfterValidator(_gravity)] = Field(
        GRAVITY_M_S2,
        description="the acceleration of gravity in metres per second squared, from 0.1 to 30; on the ground it is 9.78 to 9.83",
    )


class DieTable(TomlTable):
    """`[die]`, in scenes and throws alike."""

    shape: Annotated[str, AfterValidator(_known_shape)] = Field(description=f"one of {', '.join(SHAPES)}")
    edge_m: Positive = Field(description="the edge of the sharp polyhedron in metres, above 0")
    mass_kg: Positive = Field(description="the mass in kilograms, above 0")
    corner_radius_m: Radius | None = Field(
        None, description='the radius of the rounded corners in metres, 0 or more, or "estimate"'
    )
    inertia_kg_m2: Positive | None = Field(None, description="the moment of inertia in kg m², above 0")
    marks: Annotated[str, AfterValidator(_known_marks)] | None = Field(
        None, description='"pips", "numbers", or no such key for plain faces'
    )


# --- from tables to values ---


def table_from(table: TableTable, world: WorldTable) -> Table:
    """The table of a `[table]` table, where a `[world]` table says that it stands."""
    motion = table.motion
    moves = None if motion is None else Motion(motion.amplitude_m, motion.frequency_hz, motion.phase_rad)
    return Table(table.surface, moves, world.gravity_m_s2)


def die_from(table: DieTable, path: Path) -> Die:
    """The die of a `[die]` table, with sharp corners where it gives no radius. Raises SceneError for an impossible one."""
    _check_density(table, path)
    if table.marks == "pips" and table.shape != "cube":
        raise refuse(path, "die.marks", "pips", f'a {table.shape} has no pips; wanted "numbers", or no such key')
    die = make_die(table.shape, table.edge_m, table.mass_kg, marks=table.marks)
    largest = MAX_CORNER_RADIUS_FRACTION * die.solid.inradius
    given = table.corner_radius_m
    radius = given if isinstance(given, float) else 0.0
    if radius > largest:
        guess = unit_guess(radius, (1e-3, 1e-6), lambda radius: radius <= largest)
        wanted = f"wanted metres, at most {MAX_CORNER_RADIUS_FRACTION:g} of the inscribed radius, {largest:.4g}{guess}"
        raise refuse(path, "die.corner_radius_m", radius, wanted)
    _check_inertia(table, die.with_corner_radius(radius), path)
    return make_die(
        table.shape,
        table.edge_m,
        table.mass_kg,
        inertia_kg_m2=table.inertia_kg_m2,
        corner_radius_m=radius,
        marks=table.marks,
    )


def _check_density(table: DieTable, path: Path) -> None:
    low, high = MIN_DENSITY_KG_M3, MAX_DENSITY_KG_M3

    def possible(edge_m: float, mass_kg: float) -> bool:
        return low <= mass_kg / _volume_m3(table.shape, edge_m) <= high

    if table.edge_m > MAX_EDGE_M:
        guess = unit_guess(table.edge_m, (1e-3, 1e-2), lambda edge: possible(edge, table.mass_kg))
        raise refuse(path, "die.edge_m", table.edge_m, f"wanted metres, at most {MAX_EDGE_M:g}{guess}")
    if not possible(table.edge_m, table.mass_kg):
        density = table.mass_kg / _volume_m3(table.shape, table.edge_m)
        guess = unit_guess(table.mass_kg, (1e-3, 1e-6, 1e3), lambda mass: possible(table.edge_m, mass))
        wanted = (
            f"with edge_m = {table.edge_m:g} that is {density:.3g} kg/m³; wanted kilograms, {low:g} to {high:g} kg/m³"
        )
        raise refuse(path, "die.mass_kg", table.mass_kg, wanted + guess)


def _check_inertia(table: DieTable, die: Die, path: Path) -> None:
    """Raise SceneError for an impossible moment of inertia. No mass lies outside the corners: J = ⅔ Σ m r² <= ⅔ m R²."""
    most = 2.0 / 3.0 * die.mass_kg * die.solid.circumradius**2
    if table.inertia_kg_m2 is not None and not MIN_INERTIA_SHARE * most <= table.inertia_kg_m2 <= most:
        wanted = (
            f"wanted kg m², {MIN_INERTIA_SHARE * most:.4g} to {most:.4g}, the most with all the mass at the corners; "
            f"a homogeneous die has {die.inertia_kg_m2:.4g}"
        )
        raise refuse(path, "die.inertia_kg_m2", table.inertia_kg_m2, wanted)


def _volume_m3(shape: str, edge_m: float) -> float:
    """Volume, as the sum of the tetrahedra from the centre to triangles of the faces."""
    solid = make_die(shape, edge_m, 1.0).solid
    volume = 0.0
    for face in solid.faces:
        corners = solid.vertices[list(face)]
        for j in range(1, len(face) - 1):
            volume += float(corners[0] @ np.cross(corners[j], corners[j + 1])) / 6.0
    return volume
