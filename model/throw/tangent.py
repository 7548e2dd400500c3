"""A throw through its bounces, with derivatives by its start and by parameters of die, law and table.

    propagate(die, start, law, times_s, *, vertices=None, table=LEVEL, parameters=("chi",)) -> Propagation

The derivatives are those of the exact motion, not differences. In flight, over t,

    δp → δp + t δv + t²/2 δg,    δ → exp(ωt) δ + t J(ωt) δω,    δv → δv + t δg,    δω → δω,

where δ is the rotation vector of a small turn in world axes, R_true = exp(δ) R, and J the left Jacobian of exp
(Barfoot, State Estimation for Robotics, 2017, Eq. 7.77). The instant of a touch follows from its condition h = 0:

    δt = -(δp_z + (δ × r)_z + (R δb)_z - δs) / u,

with u the vertical velocity of the vertex relative to the table, r = R b its arm, and s the height of the table. δb and
δs, as δg above, are direct effects of a parameter. The disturbances are carried to the disturbed instant with the
velocities before the impact, through the derivative of the impact, and back to the undisturbed instant with the
velocities after it (the saltation matrix of a hybrid system: Aizerman & Gantmacher 1958; Müller 1995). Grazing touches,
u → 0, have no derivative, and near them it is large.

The impulse S is a function of the arm, the contact velocity, χ, μ, the inertia and the speed scale, so that

    δS = ∂S/∂r δr + ∂S/∂c δc + ∂S/∂χ δχ + …,    δv = δS/m,    δω = (δr × S + r × δS)/J - δJ/J² r × S.

Without friction the gradient of S has a closed form. With friction it is taken by differences of this one impact, to
some 1e-10 of itself, because S is an analytic function of its arguments as long as the slip has the same phases. S or
its gradient jumps where these phases change: where the slip just stops as the impact ends (in Stronge's and Poisson's
restitution also as compression ends), where a slip that has stopped is about to slide again (|T⁻¹b| = μ), and where a
contact comes down without slip but friction is too weak to hold it. Within `engine.impact.DIFFERENCE_STEP` of such a
border the two sides are mixed.

**Parameters** by name. A parameter that die, law or table do not have, or that does not act, has columns of zeros.

- `chi` (of the slowest impacts, if it falls with speed), `mu`, `speed_scale_m_s`: of the law. At χ = 0 and μ = 0 the
  derivative is one-sided, from above.
- `corner_radius_m`: the flat faces stay, and the touching points are those of the inner polyhedron (`body`).
- `inertia_kg_m2`, of a die with the same moment of inertia about every axis.
- `centre_of_mass_x_m`, `_y_m`, `_z_m`: from the centroid, along the body axes; the tensor about it stays. The start
  stays that of the centroid. Such a throw, and that of any asymmetric die, uses the kernel of `asymmetric_tangent`,
  without drag and without a friction that fades.
- `tilt_x_rad`, `tilt_y_rad`: a further small turn of the table about the world's x and y axes through the origin.
  Gravity and the start stay as they are in the world.
- `table_amplitude_m`, `table_frequency_hz`, `table_phase_rad`: of an oscillating table. The amplitude acts, with its
  one-sided derivative, also on a table that has a frequency and no amplitude.
- `drag_per_m`: k in v' = g - k |v| v, in 1/m, half of ρ c A/m, about 0.03 for a light cube of 16 mm. The value itself
  is an argument. With drag, or its derivative, the motion of the centre has no closed form. It is integrated by the
  method of order 8 of Dormand and Prince together with its variational equations (`engine.air`); a perturbation of the
  parabola would need several orders at k v t = 0.1. Not for asymmetric dice.

For a fit, prescribe the vertices. Then each flight lasts until that very vertex comes down, even if another dips below
the table a little meanwhile, and the poses are a smooth function of the start as long as none of the impacts vanishes.
Without prescription the first touch counts each time, and the order of impacts may change from one trial to the next.
Held contact is not followed: `propagate` ends a throw where its bounces follow each other without end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import engine
from ..die import Die, inner_vertices
from ..engine import derivatives
from ..errors import InputError
from ..laws import LEVEL, ImpactLaw, SmoothImpact, Table, checked_drag
from ..rotations import cross_matrix, matrix_from_quat, quat_multiply
from .asymmetric_tangent import (
    CENTRE_OF_MASS_AXES,
    TangentRun,
    run_asymmetric_tangent,
    throw_from_flights,
)
from .body import body_of, centroid_state, checked_release, packed_start, unpacked_state
from .history import state_after, throw_from_log
from .motion import State, Throw, rotated_state
from .simulate import Ending
from .supported import BodyKind, Door, body_kind, refuse_unsupported

Array = NDArray[np.float64]

PARAMETERS = (
    "chi",
    "mu",
    "speed_scale_m_s",
    "corner_radius_m",
    "inertia_kg_m2",
    "tilt_x_rad",
    "tilt_y_rad",
    "table_amplitude_m",
    "table_frequency_hz",
    "table_phase_rad",
    "drag_per_m",
    "centre_of_mass_x_m",
    "centre_of_mass_y_m",
    "centre_of_mass_z_m",
)
"""Names of the parameters by which a throw can be differentiated, besides its start."""

TILT_AXES = {"tilt_x_rad": np.array([1.0, 0.0, 0.0]), "tilt_y_rad": np.array([0.0, 1.0, 0.0])}
"""World axes about which the table is turned, by parameter."""

IMPACT_CAP = 100_000
"""Impacts after which a throw without prescribed vertices is stopped: more than any fitted clip can hold."""

RADIUS_STEP_FRACTION = 0.01
"""Step of the derivative by the corner radius of a sharp die, in inscribed radii. Any step is exact, because the corners of the
inner polyhedron move along straight lines."""

CACHED_BODIES = 16
"""Dice whose kernel records are kept. A fit asks for the same die again and again, and a record takes as long as a throw."""

_body = lru_cache(maxsize=CACHED_BODIES)(body_of)


@dataclass(frozen=True, eq=False)
class Propagation:
    """Poses at the requested times, with their derivatives, and the throw that they belong to."""

    positions_m: Array
    """(n, 3)."""
    quaternions: Array
    """(n, 4) wxyz."""
    jacobian: Array
    """(n, 6, 12 + m). Rows: position [m] and world rotation vector [rad] of the pose at a fixed time. Columns: position, world
    rotation vector, velocity and angular velocity of the start, then the m parameters in the order of the call."""
    impact_times_s: Array
    """(k,)."""
    impact_jacobian: Array
    """(k, 12 + m) of the instants of the impacts [s], by the same columns."""
    make_throw: Callable[[], Throw] = field(repr=False)
    last_start: State
    """Start of the last flight, in world axes: the state after the last impact, or the start itself."""

    @cached_property
    def throw(self) -> Throw:
        """The throw, built on first use because that takes ten times as long as the poses.

        With prescribed vertices it has fewer impacts than vertices if one of them never touches again.
        """
        return self.make_throw()


def propagate(
    die: Die,
    start: State,
    law: ImpactLaw | float,
    times_s: ArrayLike,
    *,
    vertices: Sequence[int] | None = None,
    table: Table = LEVEL,
    parameters: Sequence[str] = ("chi",),
    drag_per_m: float = 0.0,
) -> Propagation:
    """The poses of a throw at `times_s` (n,) [s], and their derivatives by its start and by the `parameters`.

    A number as `law` is the χ of smooth impacts. Times may be in any order, and before the start, where the first flight is
    extrapolated. `vertices` prescribes which vertex touches at each impact. After the last of them the flight continues,
    through the table if a time asks for it. If one never touches again, it and all later impacts are left out. Poses are NaN
    behind an impact that leaves no velocities that a throw can have, as where a prescribed vertex begins far below the table.
    Without `vertices` the first touch counts every time, as in `throw_die`.

    Raises ValueError for an invalid start, law or parameter, and for a vertex that does not exist. Without `vertices` also for
    a start below the table, and for times after the bounces follow each other without end.
    """
    law = SmoothImpact(law) if isinstance(law, float | int) else law
    _check_names(parameters)
    kind = body_kind(die)
    if kind is BodyKind.CENTRED and any(name in CENTRE_OF_MASS_AXES for name in parameters):
        kind = BodyKind.LOADED
    differentiated = _differentiated_law(law, parameters)
    refuse_unsupported(Door.DERIVATIVES, kind, differentiated, bool(drag_per_m) or "drag_per_m" in parameters)
    packed = packed_start(die, start, table) if vertices is not None else checked_release(die, start, table)
    times = np.atleast_1d(np.asarray(times_s, float))
    if times.ndim != 1 or not np.isfinite(times).all():
        raise InputError(f"times_s of shape {times.shape}: wanted finite times (n,) in seconds")
    order = np.argsort(times, kind="stable")
    run = TangentRun(
        differentiated,
        table.plane,
        _air(drag_per_m, parameters),
        packed,
        float(start.time_s),
        times[order],
        derivatives.ImpactSequence(_checked_vertices(die, vertices), vertices is None, IMPACT_CAP),
        _start_jacobian(die, packed, table, parameters),
        _parameter_derivatives(die, law, table, parameters),
    )
    is_asymmetric = kind is not BodyKind.CENTRED
    code, poses, jacobian, log, impact_jacobian = (
        run_asymmetric_tangent(die, parameters, run)
        if is_asymmetric
        else derivatives.run_tangent(engine.Setup(_body(die), run.law, run.plane, engine.FINE), *run[2:])
    )
    _check_end(code, times, log, start.time_s)
    end_s = float(max([start.time_s, *times[-1:], *log[-1:, 0]]))
    make_throw = (
        partial(throw_from_flights, die, start, table, log, end_s)
        if is_asymmetric
        else partial(throw_from_log, die, run.start, run.start_time_s, log, end_s, table=table, drag_per_m=drag_per_m)
    )
    back = np.argsort(order, kind="stable")
    positions, quaternions, jacobian = _in_world(die, table, parameters, poses[back], jacobian[back])
    last = _state_after_impact(die, table, log[-1], is_asymmetric) if len(log) else start
    return Propagation(positions, quaternions, jacobian, log[:, 0].copy(), impact_jacobian, make_throw, last)


def _check_names(parameters: Sequence[str]) -> None:
    """Raise ValueError unless each parameter is known and named once."""
    for name in parameters:
        if name not in PARAMETERS or list(parameters).count(name) > 1:
            raise InputError(f"parameters = {list(parameters)}: wanted each once, of {', '.join(PARAMETERS)}")


def _check_end(code: int, times: Array, log: Array, start_s: float) -> None:
    """Raise ValueError for a throw that ended before the last of the times."""
    if code in (engine.CHATTER, engine.IMPACT_CAP):
        ending = Ending.CHATTER if code == engine.CHATTER else Ending.IMPACT_CAP
        last = log[-1, 0] if len(log) else start_s
        raise InputError(f"times_s up to {times.max():.6g}: {ending.value} The last impact was at {last:.6g} s.")


def _checked_vertices(die: Die, vertices: Sequence[int] | None) -> NDArray[np.int64]:
    """The prescribed vertices as an array (k,); empty for None. Raises ValueError for one that the die does not have."""
    sequence = np.array([] if vertices is None else list(vertices), np.int64)
    count = len(die.solid.vertices)
    if ((sequence < 0) | (sequence >= count)).any():
        raise InputError(f"vertices = {sequence.tolist()}: wanted indices from 0 to {count - 1}")
    return sequence


def _differentiated_law(law: ImpactLaw, parameters: Sequence[str]) -> engine.Law:
    """The law as the kernels take it. With a derivative by μ it keeps its friction at μ = 0 too."""
    if "mu" in parameters and _has_friction(law):
        return engine.RoughLaw(law.code, law.parameters)
    return engine.law_of(law.code, law.parameters)


def _air(drag_per_m: float, parameters: Sequence[str]) -> engine.Vacuum | engine.Air:
    """Air if there is drag, or if a derivative by drag is asked for; otherwise vacuum. Raises ValueError as `checked_drag`."""
    if checked_drag(drag_per_m) == 0.0 and "drag_per_m" not in parameters:
        return engine.Vacuum(0.0)
    return engine.Air(float(drag_per_m), np.array([1.0 if name == "drag_per_m" else 0.0 for name in parameters]))


def _has_friction(law: ImpactLaw) -> bool:
    """Whether a derivative by μ acts."""
    return law.code in (engine.COULOMB, engine.COULOMB_BY_SPEED)


def _depends_on_speed(law: ImpactLaw) -> bool:
    """Whether a derivative by the speed scale acts."""
    return law.code in (engine.SMOOTH_BY_SPEED, engine.COULOMB_BY_SPEED)


def _start_jacobian(die: Die, packed: Array, table: Table, parameters: Sequence[str]) -> Array:
    """Derivatives (12, 12 + m) of the packed start, by the start in world axes and by the parameters."""
    jacobian = np.zeros((12, 12 + len(parameters)))
    jacobian[:, :12] = np.kron(np.eye(4), _world_from_table(table).T) if table.tilt_rad else np.eye(12)
    for column, name in enumerate(parameters, 12):
        if name == "corner_radius_m":
            jacobian[2, column] = -1.0
        elif name in TILT_AXES:
            # The table turns by e, so the die turns by -e about the origin in the axes of the table.
            e = _world_from_table(table).T @ TILT_AXES[name]
            turn = -cross_matrix(e)
            jacobian[:3, column] = turn @ (packed[:3] + np.array([0.0, 0.0, die.corner_radius_m]))
            jacobian[3:6, column] = -e
            jacobian[6:9, column], jacobian[9:12, column] = turn @ packed[7:10], turn @ packed[10:13]
    return jacobian


def _parameter_derivatives(
    die: Die, law: ImpactLaw, table: Table, parameters: Sequence[str]
) -> derivatives.ParameterDerivatives:
    """Derivatives of the inputs of the kernels by each parameter."""

    def unit(name: str, acts: bool = True) -> Array:
        """(m,) 1 for the parameter of that name if it acts, otherwise 0."""
        return np.array([1.0 if acts and given == name else 0.0 for given in parameters])

    by_parameter = derivatives.ParameterDerivatives(
        chi=unit("chi"),
        mu=unit("mu", _has_friction(law)),
        speed_scale=unit("speed_scale_m_s", _depends_on_speed(law)),
        inertia=unit("inertia_kg_m2", die.isotropic_inertia_kg_m2 is not None),
        corner_radius=unit("corner_radius_m"),
        vertices=np.zeros((len(parameters), *die.solid.vertices.shape)),
        gravity=np.zeros((len(parameters), 3)),
        table=np.column_stack(
            [
                unit("table_amplitude_m", table.frequency_hz > 0.0),
                2.0 * np.pi * unit("table_frequency_hz"),
                unit("table_phase_rad"),
            ]
        ),
    )
    for p, name in enumerate(parameters):
        if name == "corner_radius_m":
            step = die.corner_radius_m or RADIUS_STEP_FRACTION * die.solid.inradius
            by_parameter.vertices[p] = (inner_vertices(die.solid, step) - die.solid.vertices) / step
        elif name in CENTRE_OF_MASS_AXES:
            by_parameter.vertices[p] = -CENTRE_OF_MASS_AXES[name]
        elif name in TILT_AXES:
            plane = table.plane
            turn = -cross_matrix(_world_from_table(table).T @ TILT_AXES[name])
            by_parameter.gravity[p] = turn @ np.array([plane.gx, plane.gy, -plane.g])
    return by_parameter


def _world_from_table(table: Table) -> Array:
    """(3, 3) from the table's axes to the world's."""
    return matrix_from_quat(table.world_from_table) if table.tilt_rad else np.eye(3)


def _in_world(
    die: Die, table: Table, parameters: Sequence[str], poses: Array, jacobian: Array
) -> tuple[Array, Array, Array]:
    """Positions (n, 3), quaternions (n, 4) and derivatives (n, 6, 12 + m) of the poses, from the table's axes."""
    positions, quaternions = poses[:, :3] + np.array([0.0, 0.0, die.corner_radius_m]), poses[:, 3:]
    if table.tilt_rad:
        turn = _world_from_table(table)
        positions, quaternions = positions @ turn.T, quat_multiply(table.world_from_table, quaternions)
        jacobian = np.concatenate([turn @ jacobian[:, :3], turn @ jacobian[:, 3:]], axis=1)
    for column, name in enumerate(parameters, 12):
        if name == "corner_radius_m":
            jacobian[:, :3, column] += _world_from_table(table)[:, 2]
        elif name in TILT_AXES:
            jacobian[:, :3, column] += positions @ cross_matrix(TILT_AXES[name]).T
            jacobian[:, 3:, column] += TILT_AXES[name]
    return positions, quaternions, jacobian


def _state_after_impact(die: Die, table: Table, row: Array, is_asymmetric: bool) -> State:
    """The state of the centroid after a logged impact, in world axes."""
    packed = state_after(row)
    if is_asymmetric:
        state = centroid_state(die, unpacked_state(packed, row[0]))
    else:
        packed[2] += die.corner_radius_m
        state = unpacked_state(packed, row[0])
    return rotated_state(state, table.world_from_table) if table.tilt_rad else state
