"""What scenes and throws say of the die, of the table, and of gravity where it stands.

TOML tables that both files have, and the values of the model that they become."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from ..model.die import (
    MAX_CORNER_RADIUS_FRACTION,
    MESH_SUFFIXES,
    SOLID_KINDS,
    Die,
    Solid,
    die_from_solid,
    named_solid,
    solid_from_mesh,
)
from ..model.errors import InputError
from ..model.laws import Table as ModelTable
from ..model.world import GRAVITY_M_S2
from .settings import (
    FilesBeside,
    NotNegative,
    Positive,
    PositiveInt,
    SceneError,
    TomlTable,
    Vector3,
    not_negative,
    read_toml,
    refuse,
    shown,
    unit_guess,
    validate,
)

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
    if value not in SOLID_KINDS and not is_mesh(value):
        raise InputError("unknown shape")
    return value


def _radius_or_estimate(value: float | str) -> float | str:
    if isinstance(value, str):
        if value != ESTIMATE:
            raise InputError("no such word")
        return value
    return not_negative(value)


def _known_marks(value: str) -> str:
    if value not in ("pips", "numbers"):
        raise InputError("unknown marks")
    return value


def _gravity(value: float) -> float:
    if not GRAVITY_RANGE_M_S2[0] <= value <= GRAVITY_RANGE_M_S2[1]:
        raise InputError("out of range")
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
    """`[die]`, in scenes and throws alike. Which lengths belong to a shape is in `model.die.SOLID_KINDS`."""

    shape: Annotated[str, AfterValidator(_known_shape)] = Field(
        description=f"one of {', '.join(SOLID_KINDS)}, or a file of a mesh ({', '.join(MESH_SUFFIXES)}) beside this one"
    )
    edge_m: Positive | None = Field(None, description="the edge of the sharp polyhedron in metres, above 0")
    short_edge_m: Positive | None = Field(None, description="the shorter edge of a d10 in metres, above 0")
    edges_m: list[Positive] | None = Field(
        None, description="3 lengths of a cuboid in metres, along x, y and z of the body"
    )
    sides: PositiveInt | None = Field(
        None, description="the corners of a dipyramid's polygon, a whole number from 3 on"
    )
    radius_m: Positive | None = Field(
        None, description="the distance of these corners from the axis in metres, above 0"
    )
    half_height_m: Positive | None = Field(
        None, description="the height of a dipyramid's uncut tips in metres, above 0"
    )
    cut: NotNegative | None = Field(None, description="the part of the height of each tip that is cut off, below 1")
    corners_m: list[Vector3] | None = Field(
        None, description="4 or more corners of a polyhedron, each of 3 numbers in metres"
    )
    unit_m: Positive | None = Field(
        None, description="the length of one unit of a mesh in metres, 0.001 for millimetres"
    )
    mass_kg: Positive = Field(description="the mass in kilograms, above 0")
    corner_radius_m: Radius | None = Field(
        None, description='the radius of the rounded corners in metres, 0 or more, or "estimate"'
    )
    inertia_kg_m2: Positive | None = Field(None, description="the moment of inertia in kg m², above 0")
    marks: Annotated[str, AfterValidator(_known_marks)] | None = Field(
        None, description='"pips", "numbers", or no such key for plain faces'
    )

    @property
    def dimensions(self) -> dict[str, Any]:
        """The given lengths of the solid."""
        given = {name: getattr(self, name) for name in _DIMENSIONS}
        return {name: value for name, value in given.items() if value is not None}


_DIMENSIONS = (*dict.fromkeys(name for kind in SOLID_KINDS.values() for name in kind.dimensions), "unit_m")


# --- from tables to values ---


def table_from(table: TableTable, world: WorldTable) -> Table:
    """The table of a `[table]` table, where a `[world]` table says that it stands."""
    motion = table.motion
    moves = None if motion is None else Motion(motion.amplitude_m, motion.frequency_hz, motion.phase_rad)
    return Table(table.surface, moves, world.gravity_m_s2)


class _DieFile(TomlTable):
    die: DieTable = Field(description="a [die] table with shape, its lengths (edge_m) and mass_kg")


def read_die(path: Path) -> tuple[Die, tuple[Path, ...]]:
    """The die of a scene, of a throw file, or of a file with a `[die]` table alone, and the files that describe it. Raises
    SceneError, one sentence a mistake."""
    data, _ = read_toml(path)
    given = data.get("die")
    if isinstance(given, dict):
        data = {"die": {key: value for key, value in given.items() if key != "edge_sigma_m"}}
    table = validate(_DieFile, {key: value for key, value in data.items() if key == "die"}, path).die
    if table.corner_radius_m == ESTIMATE:
        raise refuse(path, "die.corner_radius_m", ESTIMATE, "there are no pictures to estimate from; wanted metres")
    die, mesh = die_from(table, path, FilesBeside(path, allow_outside=True))
    return die, (path,) if mesh is None else (path, mesh)


def is_mesh(shape: str) -> bool:
    """Whether the shape of a `[die]` table names a file."""
    return Path(shape).suffix.lower() in MESH_SUFFIXES


def die_from(table: DieTable, path: Path, files: FilesBeside) -> tuple[Die, Path | None]:
    """The die of a `[die]` table, with sharp corners where it gives no radius, and the file of its mesh if it has one.

    Raises SceneError for an impossible die."""
    solid, mesh = _solid(table, path, files)
    _check_density(table, solid, path)
    die = die_from_solid(solid, table.mass_kg, marks=table.marks)
    die = _rounded(table, die, path)
    if table.inertia_kg_m2 is not None:
        _check_inertia(table, die, path)
        die = replace(die, inertia_kg_m2=table.inertia_kg_m2, is_homogeneous=False)
    if table.marks == "pips" and table.shape != "cube":
        raise refuse(path, "die.marks", "pips", f'a {table.shape} has no pips; wanted "numbers", or no such key')
    return die, mesh


def _solid(table: DieTable, path: Path, files: FilesBeside) -> tuple[Solid, Path | None]:
    """The sharp solid, and the file of its mesh. Raises SceneError for lengths that are missing, or of another shape."""
    known = _known_dimensions(table)
    for name, value in table.dimensions.items():
        if name not in known:
            raise refuse(path, f"die.{name}", value, f"not of a {table.shape}; wanted {', '.join(known)}")
    for name, wanted in known.items():
        if name not in table.dimensions and not _may_be_left_out(table, name):
            raise SceneError(f"{path}: die.{name} is missing; wanted {wanted}")
    mesh = (
        files.existing(table.shape, "die.shape", "the path of a mesh, relative to this file")
        if is_mesh(table.shape)
        else None
    )
    try:
        if mesh is None:
            return named_solid(table.shape, **table.dimensions), None
        assert table.unit_m is not None
        return replace(solid_from_mesh(mesh, table.unit_m), dimensions=table.dimensions), mesh
    except ValueError as error:
        raise SceneError(f"{path}: [die]: {error}") from error


def _known_dimensions(table: DieTable) -> dict[str, str]:
    if is_mesh(table.shape):
        return {"unit_m": "the length of one unit of the mesh in metres, 0.001 for millimetres"}
    return SOLID_KINDS[table.shape].dimensions


def _may_be_left_out(table: DieTable, name: str) -> bool:
    return not is_mesh(table.shape) and name in SOLID_KINDS[table.shape].optional


def _rounded(table: DieTable, die: Die, path: Path) -> Die:
    """The die with the corner radius of the table, if it gives one. Raises SceneError for one that leaves no solid."""
    given = table.corner_radius_m
    radius = given if isinstance(given, float) else 0.0
    largest = MAX_CORNER_RADIUS_FRACTION * die.solid.inradius
    if radius > largest:
        guess = unit_guess(radius, (1e-3, 1e-6), lambda radius: radius <= largest)
        wanted = f"wanted metres, at most {MAX_CORNER_RADIUS_FRACTION:g} of the inscribed radius, {largest:.4g}{guess}"
        raise refuse(path, "die.corner_radius_m", radius, wanted)
    try:
        return die.with_corner_radius(radius)
    except ValueError as error:
        raise SceneError(f"{path}: die.{error}") from error


def _check_density(table: DieTable, solid: Solid, path: Path) -> None:
    low, high = MIN_DENSITY_KG_M3, MAX_DENSITY_KG_M3
    edge_m, volume_m3 = solid.edge_m, solid.volume_m3

    def possible(factor: float, mass_kg: float) -> bool:
        return low <= mass_kg / (factor**3 * volume_m3) <= high

    length = next(name for name in _DIMENSIONS if name in table.dimensions and name != "sides")
    given = table.dimensions[length]
    if edge_m > MAX_EDGE_M:
        factor = next((factor for factor in (1e-3, 1e-2) if possible(factor, table.mass_kg)), None)
        single = isinstance(given, float)
        guess = "" if factor is None else f"; did you mean {factor * given if single else factor * edge_m:.6g}?"
        edges = "" if single else f"; its edges are {edge_m:.4g} in the mean"
        raise refuse(path, f"die.{length}", given, f"wanted metres, at most {MAX_EDGE_M:g}{edges}{guess}")
    if not possible(1.0, table.mass_kg):
        guess = unit_guess(table.mass_kg, (1e-3, 1e-6, 1e3), lambda mass: possible(1.0, mass))
        wanted = (
            f"with {length} = {shown(given)} that is {table.mass_kg / volume_m3:.3g} kg/m³; wanted kilograms, {low:g} to "
            f"{high:g} kg/m³"
        )
        raise refuse(path, "die.mass_kg", table.mass_kg, wanted + guess)


def _check_inertia(table: DieTable, die: Die, path: Path) -> None:
    """Raise SceneError for an impossible moment of inertia. No mass lies outside the corners: J = ⅔ Σ m r² <= ⅔ m R²."""
    if not die.is_spherical_top:
        wanted = f"a {table.shape} has several moments of inertia, which follow from shape and mass; wanted no such key"
        raise refuse(path, "die.inertia_kg_m2", table.inertia_kg_m2, wanted)
    most = 2.0 / 3.0 * die.mass_kg * die.solid.circumradius**2
    if table.inertia_kg_m2 is not None and not MIN_INERTIA_SHARE * most <= table.inertia_kg_m2 <= most:
        wanted = (
            f"wanted kg m², {MIN_INERTIA_SHARE * most:.4g} to {most:.4g}, the most with all the mass at the corners; "
            f"a homogeneous die has {die.inertia_kg_m2:.4g}"
        )
        raise refuse(path, "die.inertia_kg_m2", table.inertia_kg_m2, wanted)
