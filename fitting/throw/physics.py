"""The physics of a throw: die, table, and the numbers of the laws in use, each of them free or held.

The plainest model is the paper's: a smooth impact with one χ. Everything else is an effect with parameters of its own.
An effect that is not in use adds no parameter, no computing time and no line in the result.

| effect | parameters | no effect at |
| --- | --- | --- |
| friction | `mu`, Coulomb, along the normal impulse (`model.laws.CoulombImpact`) | 0 |
| fading restitution | `chi_fade_s_per_m` = 1/u_s of `model.laws.RestitutionBySpeed` | 0 |
| fading friction | `mu_fade_s_per_m` = 1/u_s of `model.laws.FrictionBySpeed`; joint fits only | 0 |
| rounded corners | `corner_radius_m` | 0 |
| inertia | `inertia_kg_m2` | that of the homogeneous die |
| loaded die | `centre_of_mass_x_m`, `_y_m`, `_z_m` from the centroid, body axes; one moment of inertia about it | 0 |
| tilted table | `tilt_x_rad`, `tilt_y_rad`: its normal turned about the world's x and y | 0 |
| oscillating table | `table_amplitude_m`, `table_frequency_hz`, `table_phase_rad`: z = A sin(2πft + phase) | 0 |
| air drag | `drag_per_m`: dv/dt = -k |v| v | 0 |
| clock | `clock_scale`: true seconds in a second of the track | 1 |
| length scale | `length_scale`: metres of the track in a true metre | 1 |
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ...model import engine
from ...model.die import Die, largest_corner_radius
from ...model.errors import InputError
from ...model.laws import (
    CoulombImpact,
    FrictionBySpeed,
    ImpactLaw,
    Restitution,
    RestitutionBySpeed,
    SmoothImpact,
    Table,
)
from ...model.rotations import quat_conjugate
from ...model.throw import (
    SUPPORTED,
    Action,
    BodyKind,
    Door,
    Propagation,
    State,
    ThrowResult,
    Until,
    body_kind,
    body_of,
    checked_release,
    needs_asymmetric_kernels,
    propagate,
    rotated_state,
    throw_asymmetric_die,
    throw_die,
)
from ...tracking.track import Track
from ..free import CENTRE_OF_MASS, TABLE_MOTION
from ..results import MOST_FRICTION

Array = NDArray[np.float64]

EFFECTS: dict[str, tuple[str, ...]] = {
    "friction": ("mu",),
    "fading restitution": ("chi_fade_s_per_m",),
    "rounded corners": ("corner_radius_m",),
    "inertia": ("inertia_kg_m2",),
    "loaded die": CENTRE_OF_MASS,
    "tilted table": ("tilt_x_rad", "tilt_y_rad"),
    "oscillating table": TABLE_MOTION,
    "air drag": ("drag_per_m",),
    "clock": ("clock_scale",),
    "length scale": ("length_scale",),
}
"""The parameters of every effect that a fit may free."""

ACTIONS = {
    "friction": Action.FRICTION,
    "fading restitution": Action.RESTITUTION_BY_SPEED,
    "fading friction": Action.FRICTION_BY_SPEED,
    "air drag": Action.DRAG,
}
"""What an effect has act on the die. A fit of one throw combines what `model.throw.supported` has derivatives of; joint fits
need none and combine more."""

_OF_ONE_MOMENT = frozenset({"inertia", "loaded die"})
"""Effects on dice with one moment of inertia only."""

RESTITUTIONS: tuple[Restitution, ...] = ("stronge", "newton", "poisson")
"""Definitions of restitution that end the same course of the slip, in the order of preference."""

_NEUTRAL = {"clock_scale": 1.0, "length_scale": 1.0}
"""Values without effect, where these are not 0."""

_BOUNDS = {
    "chi": (0.0, 1.0),
    "mu": (0.0, MOST_FRICTION),
    "chi_fade_s_per_m": (0.0, 100.0),
    "mu_fade_s_per_m": (0.0, 100.0),
    "tilt_x_rad": (-0.3, 0.3),
    "tilt_y_rad": (-0.3, 0.3),
    "drag_per_m": (0.0, 10.0),
    "table_amplitude_m": (0.0, 0.05),
    "table_frequency_hz": (0.1, 1000.0),
    "table_phase_rad": (-100.0, 100.0),
    "clock_scale": (0.8, 1.25),
    "length_scale": (0.8, 1.25),
}
"""What the laws allow, and what scenes may have."""

_MAX_OFFSET = 0.5
"""Largest component of a centre-of-mass offset, in inscribed radii."""

_MAX_CORNER_RADIUS = 0.9
"""Largest corner radius, in inscribed radii: at 1 the die is a sphere."""

_LEAST_LARGEST = 0.02
"""The largest corner radius of a solid, in inscribed radii, below which rounded corners are no effect of it."""

_INERTIA_BOUNDS = (0.2, 3.0)
"""Least and largest moment of inertia, relative to that of the die."""

CALIBRATION_LIMITS = {
    "clock_scale": 1e-3,
    "length_scale": 1e-3,
    "tilt_x_rad": 2e-3,
    "tilt_y_rad": 2e-3,
    "table_amplitude_m": 2e-5,
    "table_frequency_hz": np.inf,  # a table at rest has no frequency
    "table_phase_rad": np.inf,
}
"""Departures that a camera's calibration leaves open in every scene: a thousandth of a length, a tenth of a degree of
the table. Smaller ones are errors of the poses, whatever their sigmas state, and no effect of the scene."""

_CENTRE_OF_MASS_LIMIT = 1e-3
"""The same for a centre of mass, as a share of an edge: corners of real dice are no more accurate."""

_TYPICAL_VALUES: dict[str, tuple[dict[str, float], ...]] = {
    "friction": ({"mu": 0.1}, {"mu": 0.4}, {"mu": 1.0}),
    "fading restitution": ({"chi_fade_s_per_m": 1.0},),
}
"""Values of an effect, from small to large among those of scenes, from which fits converge."""

_MIN_FADE_S_PER_M = 1e-6
"""The law needs a finite speed scale even where nothing fades."""


COARSE = engine.Precision(0.0, 1e-4, 1.0, 1e-4)
"""For throws that are compared with frames. Against the finest setting, the poses of the cube tosses of
`benchmarks/tosses.py` shift by 1 % of an edge in the median, less than between laws. Their mean error is the same, and
they take a fifth of the time."""


@lru_cache(maxsize=64)
def kernel_body(die: Die) -> engine.Body:
    """`body_of`, which takes as long as a short throw, cached for all throws of a die."""
    return body_of(die)


def table_under(track: Track, table: Table | None) -> Table:
    """The table over which a track was filmed: level and at rest where none is given. Raises ValueError for one that stands where
    gravity is another."""
    if table is None:
        return Table(gravity_m_s2=track.gravity_m_s2)
    if table.gravity_m_s2 != track.gravity_m_s2:
        raise InputError(
            f"gravity_m_s2 = {table.gravity_m_s2:g} of the table and {track.gravity_m_s2:g} of the track; wanted the same"
        )
    return table


@dataclass(frozen=True, eq=False)
class Run:
    """Outcome of a throw simulated without prescribed vertices."""

    vertices: NDArray[np.int64]
    """(k,) the vertex of every event; -1 where nothing strikes and only the held vertices change. Empty unless kept."""
    landed_face: int | None
    """Number of the face of rest; None without one."""


@dataclass(frozen=True, eq=False)
class Physics:
    """The die, the table, and the parameters in use."""

    die: Die
    table: Table
    values: Mapping[str, float]
    """By name; `chi` first, then those of the effects in use."""
    held: frozenset[str] = field(default=frozenset())
    """Parameters in use that a fit leaves alone."""
    restitution: Restitution = "stronge"
    """What χ means in frictional contact; see `model.laws.CoulombImpact`. All definitions agree as long as no slip
    stops or turns within an impact."""

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that a fit moves, in the order of its unknowns."""
        return tuple(name for name in self.values if name not in self.held)

    @property
    def clock(self) -> float:
        """True seconds in a second of the track."""
        return self.values.get("clock_scale", 1.0)

    @property
    def length(self) -> float:
        """Metres of the track in a true metre."""
        return self.values.get("length_scale", 1.0)

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects whose parameters are in use."""
        return tuple(effect for effect, names in EFFECTS.items() if names[0] in self.values)

    def exceeds_calibration(self, effect: str) -> bool:
        """Whether an effect in use is larger than what calibration leaves open."""
        return any(
            abs(self.values[name] - self.neutral(name)) > self.calibration_limit(name) for name in EFFECTS[effect]
        )

    def is_compatible_with(self, effect: str) -> bool:
        """Whether a fit of one throw can combine an effect with those in use, and with the die."""
        effects = {*self.effects, effect}
        # On a table that oscillates, centre of mass and motion of the table explain the same bounces.
        return not {"loaded die", "oscillating table"} <= effects and self._is_supported(Door.DERIVATIVES, effects)

    def can_be_thrown_with(self, effect: str) -> bool:
        """Whether throws can combine an effect with those in use, and with the die, from the release to rest."""
        return self._is_supported(Door.THROW, {*self.effects, effect})

    @property
    def drag_per_m(self) -> float:
        """k of the air drag; 0 without it."""
        return self.values.get("drag_per_m", 0.0)

    def _is_supported(self, door: Door, effects: set[str]) -> bool:
        """Whether the model combines some effects with the die."""
        kind = body_kind(self.die)
        if kind is BodyKind.ASYMMETRIC and effects & _OF_ONE_MOMENT:
            return False
        if (
            "rounded corners" in effects
            and largest_corner_radius(self.die.solid) < _LEAST_LARGEST * self.die.solid.inradius
        ):
            return False
        if "loaded die" in effects:
            kind = BodyKind.LOADED
        return {ACTIONS[name] for name in effects if name in ACTIONS} <= SUPPORTED[door][kind]

    def calibration_limit(self, name: str) -> float:
        """Departure of a parameter that the calibration leaves open."""
        if name in CENTRE_OF_MASS:
            return _CENTRE_OF_MASS_LIMIT * self.die.solid.edge_m
        return CALIBRATION_LIMITS.get(name, 0.0)

    def bounds(self, name: str) -> tuple[float, float]:
        """Least and largest value that the law allows. Raises KeyError for a name that is no parameter."""
        if name in CENTRE_OF_MASS:
            return -_MAX_OFFSET * self.die.solid.inradius, _MAX_OFFSET * self.die.solid.inradius
        if name == "corner_radius_m":
            return 0.0, min(_MAX_CORNER_RADIUS * self.die.solid.inradius, largest_corner_radius(self.die.solid))
        if name == "inertia_kg_m2":
            least, most = _INERTIA_BOUNDS
            return least * self.die.inertia_kg_m2, most * self.die.inertia_kg_m2
        return _BOUNDS[name]

    def neutral(self, name: str) -> float:
        """The value at which a parameter has no effect."""
        if name == "corner_radius_m":
            return self.die.corner_radius_m
        if name in TABLE_MOTION:
            return float(getattr(self.table, name.removeprefix("table_")))
        if name == "inertia_kg_m2":
            return self._rounded_die.inertia_kg_m2
        return _NEUTRAL.get(name, 0.0)

    def with_values(self, **values: float) -> Physics:
        """The same with other values, each clipped to its bounds, and the centre of mass to the inside of the die."""
        kept = {name: float(np.clip(value, *self.bounds(name))) for name, value in values.items()}
        return replace(self, values=self._with_inner_centre({**self.values, **kept}))

    def _with_inner_centre(self, values: dict[str, float]) -> dict[str, float]:
        """Values whose centre of mass lies as deep inside the body of the corner radius as an offset along one axis may. Three
        coordinates within their bounds reach out of a tetrahedron."""
        if not all(name in values for name in CENTRE_OF_MASS):
            return values
        solid, centre = self.die.solid, np.array([values[name] for name in CENTRE_OF_MASS])
        radius_m = values.get("corner_radius_m", self.die.corner_radius_m)
        outward, limit = float((solid.normals @ centre).max()), _MAX_OFFSET * (solid.inradius - radius_m)
        if outward <= limit:
            return values
        return {**values, **dict(zip(CENTRE_OF_MASS, (limit / outward * centre).tolist(), strict=True))}

    def with_effect(self, effect: str) -> Physics:
        """The same with one more effect, at the values where it has no effect."""
        return self.with_values(**{name: self.neutral(name) for name in EFFECTS[effect]})

    def without_effect(self, effect: str) -> Physics:
        """The same with one effect less."""
        return replace(self, values={n: value for n, value in self.values.items() if n not in EFFECTS[effect]})

    def with_typical_values(self, effect: str) -> list[Physics]:
        """The same with one effect at several strengths, for fits that do not converge from none of it."""
        wider = self.with_effect(effect)
        return [wider.with_values(**values) for values in _TYPICAL_VALUES.get(effect, ())]

    def with_other_restitutions(self) -> list[Physics]:
        """The same with the other definitions of restitution; none without friction, where all agree."""
        if "mu" not in self.values:
            return []
        return [replace(self, restitution=kind) for kind in RESTITUTIONS if kind != self.restitution]

    def holding(self, name: str, value: float) -> Physics:
        """The same with one parameter held at a value."""
        return replace(self.with_values(**{name: value}), held=self.held | {name})

    def moved(self, change: Array) -> Physics:
        """The same with the free parameters displaced by (k,)."""
        names = self.free
        return self.with_values(**{name: self.values[name] + float(d) for name, d in zip(names, change, strict=True)})

    @cached_property
    def law(self) -> ImpactLaw:
        """The law of impact."""
        chi = self.values["chi"]
        law = CoulombImpact(chi, self.values["mu"], self.restitution) if "mu" in self.values else SmoothImpact(chi)
        fade = self.values.get("chi_fade_s_per_m")
        faded = law if fade is None else RestitutionBySpeed(law, 1.0 / max(fade, _MIN_FADE_S_PER_M))
        if "mu_fade_s_per_m" not in self.values or isinstance(law, SmoothImpact):
            return faded
        assert not isinstance(faded, SmoothImpact)
        return FrictionBySpeed(faded, 1.0 / max(self.values["mu_fade_s_per_m"], _MIN_FADE_S_PER_M))

    @cached_property
    def _rounded_die(self) -> Die:
        """The die with the fitted radius, whose inertia follows if it is homogeneous."""
        radius_m = self.values.get("corner_radius_m")
        return self.die if radius_m is None else self.die.with_corner_radius(radius_m)

    @cached_property
    def body(self) -> Die:
        """The die with the fitted radius, inertia and centre of mass."""
        die = self._rounded_die
        if "inertia_kg_m2" in self.values:
            die = replace(die, inertia_kg_m2=self.values["inertia_kg_m2"], is_homogeneous=False)
        if CENTRE_OF_MASS[0] in self.values:
            centre_m = np.array([self.values[name] for name in CENTRE_OF_MASS])
            die = replace(die, centre_of_mass_m=centre_m, is_homogeneous=False)
        return die

    @cached_property
    def plane(self) -> Table:
        """The table with the fitted tilt and motion."""
        table = self.table
        if TABLE_MOTION[0] in self.values:
            amplitude, frequency, phase = (self.values[name] for name in TABLE_MOTION)
            table = replace(table, amplitude_m=amplitude, frequency_hz=frequency, phase_rad=phase)
        if "tilt_x_rad" in self.values:
            x, y = self.values["tilt_x_rad"], self.values["tilt_y_rad"]
            # A turn about x by a tilts the normal towards -y; about y by b towards x.
            table = replace(table, tilt_rad=float(np.hypot(x, y)), downhill_rad=float(np.arctan2(-x, y)))
        return table

    def throw(self, start: State, until: Until) -> ThrowResult:
        """The throw of the die without prescribed vertices. Raises ValueError for a start below the table."""
        return throw_die(self.body, start, self.law, until=until, table=self.plane, drag_per_m=self.drag_per_m)

    def can_release(self, start: State) -> bool:
        """Whether a throw can begin there: not below the table, where fits through prescribed vertices, and draws from
        them, may lie.
        """
        return self._packed(start) is not None

    def after(self, start: State, vertices: tuple[int, ...]) -> State:
        """The state in which the last flight of a throw through prescribed vertices begins."""
        return propagate(
            self.body,
            start,
            self.law,
            [],
            vertices=vertices,
            table=self.plane,
            parameters=(),
            drag_per_m=self.drag_per_m,
        ).last_start

    def run(
        self,
        start: State,
        *,
        end_s: float = np.inf,
        impacts: int,
        keep: bool,
        precision: engine.Precision = engine.FINE,
    ) -> Run | None:
        """The outcome of a throw without prescribed vertices; None for a start below the table.

        Runs the event loop without making a `Throw`, which would take ten times as long.
        """
        packed = self._packed(start)
        if packed is None:
            return None
        if not self.body.is_spherical_top:
            return self._run_asymmetric(start, end_s, impacts, precision)
        law = engine.law_of(self.law.code, self.law.parameters)
        begin_s = float(start.time_s)
        _, _, face, _, _, log, _ = engine.run_throw(
            engine.Setup(kernel_body(self.body), law, self.plane.plane_in_air(self.drag_per_m), precision),
            packed,
            begin_s,
            engine.Limits(end_s - begin_s, engine.NO_LIMIT, impacts, end_s == np.inf),
            keep,
        )
        return Run(log[:, 1].astype(int), int(face) + 1 if face >= 0 else None)

    def _run_asymmetric(self, start: State, end_s: float, impacts: int, precision: engine.Precision) -> Run:
        """The same for a loaded die, or one with several moments of inertia."""
        law = engine.law_of(self.law.code, self.law.parameters)
        if needs_asymmetric_kernels(body_kind(self.body), law):
            motion = throw_asymmetric_die(
                self.body,
                rotated_state(start, quat_conjugate(self.plane.world_from_table)) if self.plane.tilt_rad else start,
                law,
                plane=self.plane.plane,
                precision=precision,
                duration_s=end_s - float(start.time_s),
                stop_when_decided=end_s == np.inf,
                impact_cap=impacts,
            )
            return Run(motion.log[:, 1].astype(int), motion.landed_face)
        until = Until() if end_s == np.inf else Until(time_s=end_s, impacts=impacts)
        result = self.throw(start, until)
        vertices_hit = [impact.vertices[0] if impact.vertices else -1 for impact in result.throw.impacts]
        return Run(np.array(vertices_hit, int), result.landed_face)

    def _packed(self, start: State) -> Array | None:
        """A start as the event loop takes it (13,); None where a vertex lies below the table."""
        try:
            return checked_release(self.body, start, self.plane)
        except ValueError:
            return None


@dataclass(frozen=True, eq=False)
class ModelPoses:
    """Modelled poses at the times of frames, on the track's clock and in its metres, with derivatives."""

    positions_m: Array
    """(n, 3)."""
    quaternions: Array
    """(n, 4) wxyz."""
    jacobian: Array
    """(n, 6, 12 + k) by the start (position, rotation vector, velocity, angular velocity) and the free parameters."""
    propagation: Propagation
    """On the true clock and in true metres."""


def model_poses(physics: Physics, start: State, times_s: Array, vertices: tuple[int, ...]) -> ModelPoses:
    """Poses of the throw through prescribed vertices at `times_s` (n,) on the track's clock.

    `start` is in true units: its time is that of the track times the clock scale.
    """
    clock, length = physics.clock, physics.length
    names = tuple(name for name in physics.free if name not in _NEUTRAL)
    passed = tuple("speed_scale_m_s" if name == "chi_fade_s_per_m" else name for name in names)
    propagation = propagate(
        physics.body,
        start,
        physics.law,
        clock * times_s,
        vertices=vertices,
        table=physics.plane,
        parameters=passed,
        drag_per_m=physics.drag_per_m,
    )
    jacobian = np.empty((len(times_s), 6, 12 + len(physics.free)))
    column = {name: k for k, name in enumerate(physics.free, start=12)}
    jacobian[:, :, [*range(12), *(column[name] for name in names)]] = propagation.jacobian
    if "chi_fade_s_per_m" in names:
        # The law has the speed scale, the inverse of the fade.
        fade = max(physics.values["chi_fade_s_per_m"], _MIN_FADE_S_PER_M)
        jacobian[:, :, column["chi_fade_s_per_m"]] /= -(fade**2)
    if "clock_scale" in column:
        jacobian[:, :, column["clock_scale"]] = times_s[:, None] * propagation.throw.rates(clock * times_s)
    if "length_scale" in column:
        jacobian[:, :3, column["length_scale"]] = propagation.positions_m / length
        jacobian[:, 3:, column["length_scale"]] = 0.0
    if length != 1.0:
        jacobian[:, :3] *= length
    return ModelPoses(length * propagation.positions_m, propagation.quaternions, jacobian, propagation)
