"""A throw through its bounces, with derivatives by its start and by what die, law and table are like.

    propagate(die, start, law, times_s, *, vertices=None, table=LEVEL, parameters=("chi",)) -> Propagation

The derivatives are those of the exact motion, not differences. In flight, over t,

    δp → δp + t δv + t²/2 δg,    δ → exp(ωt) δ + t J(ωt) δω,    δv → δv + t δg,    δω → δω,

where δ is the rotation vector of a small turn in world axes, R_true = exp(δ) R, and J the left Jacobian of exp
(Barfoot, State Estimation for Robotics, 2017, Eq. 7.77). The instant of a touch follows from its condition h = 0:

    δt = -(δp_z + (δ × r)_z + (R δb)_z - δs) / u,

u the vertical velocity of the vertex relative to the table, r = R b its arm, s the height of the table; δb and δs, as
δg above, are what a parameter changes by itself. The disturbances are carried on to the disturbed instant with the
velocities before the impact, through the derivative of the impact, and back to the undisturbed instant with the
velocities after it (the saltation matrix of a hybrid system: Aizerman & Gantmacher 1958; Müller 1995). Grazing touches,
u → 0, have no derivative, and near them it is large.

The impulse S is a function of the arm, the contact velocity, χ, μ, the inertia and the speed scale, and so

    δS = ∂S/∂r δr + ∂S/∂c δc + ∂S/∂χ δχ + …,    δv = δS/m,    δω = (δr × S + r × δS)/J - δJ/J² r × S.

The gradient of S has a closed form where nothing rubs. With friction it is taken by differences of this one impact, to
some 1e-10 of itself: an analytic function of its arguments as long as the slip takes the same course. It jumps, or the
impulse itself does, where that course changes: where the slip just stops as the impact ends (and in Stronge's and
Poisson's restitution, as compression ends), where a slip that has stopped is just about to slide again (|T⁻¹b| = μ),
and where a contact comes down with no slip at all but friction too weak to hold it. Within `kernels.DIFFERENCE_STEP` of such a
border the two sides are mixed.

**Parameters** by name; those that the law, the die or the table does not have, or that do not act, have columns of
zeros.

- `chi` (of the slowest impacts, where it fades with speed), `mu`, `speed_scale_m_s`: of the law. At χ = 0 and μ = 0 the
  derivative is that from above.
- `corner_radius_m`: flat faces stay, the touching points are those of the inner polyhedron (`bodies`).
- `inertia_kg_m2`, of a die with the same moment of inertia about every axis.
- `centre_of_mass_x_m`, `_y_m`, `_z_m`: from the centroid, along the body axes; the tensor about it stays. The start stays
  that of the centroid. Such a throw, and that of any die that is no spherical top, is followed by the kernel of
  `tangent_tops`, for smooth impacts only.
- `tilt_x_rad`, `tilt_y_rad`: a further small turn of the table about the world's x and y axes through the origin.
  Gravity stays, and the start stays where it is in the world.
- `table_amplitude_m`, `table_frequency_hz`, `table_phase_rad`: of a table that oscillates. The amplitude acts, with its
  derivative from above, also on one that has a frequency and no amplitude yet.

- `drag_per_m`: k in v' = g - k |v| v, in 1/m, half of ρ c A/m, about 0.03 for a light cube of 16 mm. The value itself is
  an argument. Only where it is asked for does a flight leave its closed form; the centre is then integrated by the
  method of order 8 of Dormand and Prince, together with its variational equations. A perturbation of the parabola would
  need several orders at k v t = 0.1. Not for tops.

For a fit, prescribe the vertices. Then each flight lasts until that very vertex comes down, even if meanwhile another
dips below the table a little, and the poses are a smooth function of the start as long as none of the impacts vanishes.
Left to itself, the throw takes the first touch each time and its impacts may change order from one trial to the next.
Held contact is not followed: a throw ends for `propagate` where its bounces crowd together.
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
from ..laws import LEVEL, ImpactLaw, SmoothImpact, Table
from ..rotations import matrix_from_quat, quat_conjugate, quat_multiply
from . import asymmetric_tangent
from .asymmetric_tangent import SHIFTS, cross_matrix
from .asymmetric_throw import centroid_state
from .body import body_of
from .history import rotated_state, throw_from_log
from .motion import Flight, State, Throw
from .simulate import Ending, checked_release
from .touch import packed_state, unpacked_state

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
"""Names of what a throw can be differentiated by, besides its start."""

_IMPACT_CAP = 100_000
"""Of a throw that is left to itself."""

_body = lru_cache(maxsize=16)(body_of)
"""A fit asks for the same die again and again; what its corners imply takes as long as a throw."""


@dataclass(frozen=True, eq=False)
class Propagation:
    """Poses at the times asked for, with their derivatives, and the throw that they belong to."""

    positions_m: Array
    """(n, 3)."""
    quaternions: Array
    """(n, 4) wxyz."""
    jacobian: Array
    """(n, 6, 12 + m). Rows: position [m] and world rotation vector [rad] of the pose at a fixed time. Columns: position,
    world rotation vector, velocity and angular velocity of the start, then the m parameters in the order asked for."""
    impact_times_s: Array
    """(k,)."""
    impact_jacobian: Array
    """(k, 12 + m) of the instants of the impacts [s], by the same columns."""
    make_throw: Callable[[], Throw] = field(repr=False)
    last_start: State
    """Where the last flight begins: after the last impact, or the start itself; world axes."""

    @cached_property
    def throw(self) -> Throw:
        """The throw, made when it is first asked for: that takes ten times as long as the poses.

        With prescribed vertices it holds fewer impacts than vertices where one of them never touches again.
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

    A number as `law` is the χ of smooth impacts. Times may stand in any order, and before the start, where the first
    flight is extended. `vertices` prescribes which vertex touches at each impact: after the last of them the flight
    goes on, through the table if asked; and where one never touches again, all impacts from there on are left out.
    Without `vertices` the first touch counts every time, as in `simulate.throw_die`. Raises ValueError for a start, a
    law or a parameter that no throw has, for a vertex that does not exist, and, without `vertices`, for a start below
    the table and for times after the bounces have crowded together.
    """
    law = SmoothImpact(law) if isinstance(law, float | int) else law
    if law.code == engine.COULOMB_FADING:
        raise ValueError(f"{type(law).__name__} has no derivatives here; wanted a law whose friction does not fade")
    _check_names(parameters)
    packed = _packed(die, start, table) if vertices is not None else checked_release(die, start, table)
    sequence = _checked_vertices(die, vertices)
    times = np.atleast_1d(np.asarray(times_s, float))
    if times.ndim != 1 or not np.isfinite(times).all():
        raise ValueError(f"times_s of shape {times.shape}: wanted finite times (n,) in seconds")
    order = np.argsort(times, kind="stable")
    is_top = not die.is_spherical_top or any(name in SHIFTS for name in parameters)
    air = _air(drag_per_m, parameters)
    run = (
        partial(asymmetric_tangent.run_tangent, die, parameters)
        if is_top
        else partial(derivatives.run_tangent, _body(die))
    )
    code, poses, jacobian, log, impact_jacobian = run(
        _law_for(law, parameters),
        table.plane,
        air,
        packed,
        float(start.time_s),
        times[order],
        sequence,
        vertices is None,
        _IMPACT_CAP,
        _seed(die, packed, table, parameters),
        _sources(die, law, table, parameters),
    )
    if code in (engine.CHATTER, engine.IMPACT_CAP):
        ending = Ending.CHATTER if code == engine.CHATTER else Ending.IMPACT_CAP
        last = log[-1, 0] if len(log) else start.time_s
        raise ValueError(f"times_s up to {times.max():.6g}: {ending.value} The last impact was at {last:.6g} s.")
    back = np.argsort(order, kind="stable")
    end_s = float(max([start.time_s, *times[-1:], *log[-1:, 0]]))
    if is_top:
        make_throw = partial(asymmetric_tangent.throw_from_flights, die, start, table, log, end_s)
    else:
        make_throw = partial(_throw_in_air, die, packed, float(start.time_s), log, end_s, table, drag_per_m)
    positions, quaternions, jacobian = _in_world(die, table, parameters, poses[back], jacobian[back])
    last = _after(die, table, log[-1], is_top) if len(log) else start
    return Propagation(positions, quaternions, jacobian, log[:, 0].copy(), impact_jacobian, make_throw, last)


def _after(die: Die, table: Table, row: Array, is_top: bool) -> State:
    """The state after a logged impact, in world axes."""
    packed = np.concatenate([row[2:9], row[15:21]])
    if is_top:
        state = centroid_state(die, unpacked_state(packed, row[0]))
    else:
        packed[2] += die.corner_radius_m
        state = unpacked_state(packed, row[0])
    return rotated_state(state, table.world_from_table) if table.tilt_rad else state


def _check_names(parameters: Sequence[str]) -> None:
    """Raise ValueError unless each parameter is known and stands there once."""
    for name in parameters:
        if name not in PARAMETERS or list(parameters).count(name) > 1:
            raise ValueError(f"parameters = {list(parameters)}: wanted each once, of {', '.join(PARAMETERS)}")


def _checked_vertices(die: Die, vertices: Sequence[int] | None) -> NDArray[np.int64]:
    """The prescribed vertices as an array (k,); empty for None."""
    sequence = np.array([] if vertices is None else list(vertices), np.int64)
    count = len(die.solid.vertices)
    if ((sequence < 0) | (sequence >= count)).any():
        raise ValueError(f"vertices = {sequence.tolist()}: wanted indices from 0 to {count - 1}")
    return sequence


def _packed(die: Die, start: State, table: Table) -> Array:
    """The start as the kernels have it (13,), wherever it lies: in the table's axes, less the radius of the corners."""
    packed = packed_state(start)
    if table.tilt_rad:
        packed = packed_state(rotated_state(start, quat_conjugate(table.world_from_table)))
    packed[2] -= die.corner_radius_m
    return packed


def _law_for(law: ImpactLaw, parameters: Sequence[str]) -> engine.Law:
    """The law as the kernels have it: one with friction of nothing keeps it where it is to be differentiated by."""
    if "mu" in parameters and _rubs(law):
        return engine.RoughLaw(law.code, law.parameters)
    return engine.law_of(law.code, law.parameters)


def _air(drag_per_m: float, parameters: Sequence[str]) -> engine.Vacuum | engine.Air:
    """What a flight goes through: air only where there is any, or where its effect is asked for."""
    if not (np.isfinite(drag_per_m) and drag_per_m >= 0.0):
        raise ValueError(f"drag_per_m = {drag_per_m}: wanted 0 or more, half of ρ c A/m in 1/m")
    if drag_per_m == 0.0 and "drag_per_m" not in parameters:
        return engine.Vacuum(0.0)
    return engine.Air(float(drag_per_m), np.array([1.0 if name == "drag_per_m" else 0.0 for name in parameters]))


@dataclass(frozen=True, eq=False, kw_only=True)
class DraggedFlight(Flight):
    """Flight of a spherical top against quadratic drag; before and after it, where the same motion would lead."""

    drag_per_m: float

    def at(self, time_s: float) -> State:
        """The state at any instant."""
        flow = self._flows(np.array([time_s]))[0]
        quaternion = super().poses(np.array([time_s]))[1][0]
        return State(time_s, flow[:3], quaternion, flow[3:6], self.start.omega_rad_s)

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        times = np.atleast_1d(np.asarray(times_s, float))
        return self._flows(times)[:, :3], super().poses(times)[1]

    def _flows(self, times: Array) -> Array:
        """Positions and velocities (n, 6) at times (n,) [s]."""
        return engine.drag_trajectory(self.drag_per_m, packed_state(self.start), times - self.start.time_s)


def _throw_in_air(
    die: Die, packed: Array, begin_s: float, log: Array, end_s: float, table: Table, drag_per_m: float
) -> Throw:
    """`throw_from_log`, with flights against drag where there is any."""
    throw = throw_from_log(die, packed, begin_s, log, end_s, table=table)
    if drag_per_m == 0.0:
        return throw
    flights = tuple(DraggedFlight(start=f.start, end_s=f.end_s, drag_per_m=drag_per_m) for f in throw.flights)
    return Throw(flights, throw.impacts)


def _rubs(law: ImpactLaw) -> bool:
    return law.code in (engine.COULOMB, engine.COULOMB_BY_SPEED)


def _fades(law: ImpactLaw) -> bool:
    return law.code in (engine.SMOOTH_BY_SPEED, engine.COULOMB_BY_SPEED)


def _seed(die: Die, packed: Array, table: Table, parameters: Sequence[str]) -> Array:
    """Derivatives (12, 12 + m) of the packed start, by the start in world axes and by the parameters."""
    seed = np.zeros((12, 12 + len(parameters)))
    seed[:, :12] = np.kron(np.eye(4), _turn(table).T) if table.tilt_rad else np.eye(12)
    for column, name in enumerate(parameters, 12):
        if name == "corner_radius_m":
            seed[2, column] = -1.0
        elif name in _TILTS:
            # The table turns by e, so the die turns by -e about the origin in the axes of the table.
            e = _turn(table).T @ _TILTS[name]
            turned = -cross_matrix(e)
            seed[:3, column] = turned @ (packed[:3] + np.array([0.0, 0.0, die.corner_radius_m]))
            seed[3:6, column] = -e
            seed[6:9, column], seed[9:12, column] = turned @ packed[7:10], turned @ packed[10:13]
    return seed


_TILTS = {"tilt_x_rad": np.array([1.0, 0.0, 0.0]), "tilt_y_rad": np.array([0.0, 1.0, 0.0])}
"""World axes about which the table is turned."""


def _turn(table: Table) -> Array:
    """(3, 3) from the table's axes to the world's."""
    return matrix_from_quat(table.world_from_table) if table.tilt_rad else np.eye(3)


def _sources(die: Die, law: ImpactLaw, table: Table, parameters: Sequence[str]) -> engine.ParameterDerivatives:
    """What each parameter changes in what the kernels are given."""
    m = len(parameters)

    def own(name: str, acts: bool = True) -> Array:
        return np.array([1.0 if acts and given == name else 0.0 for given in parameters])

    sources = engine.ParameterDerivatives(
        chi=own("chi"),
        mu=own("mu", _rubs(law)),
        speed_scale=own("speed_scale_m_s", _fades(law)),
        inertia=own("inertia_kg_m2", _is_isotropic(die)),
        corner_radius=own("corner_radius_m"),
        vertices=np.zeros((m, *die.solid.vertices.shape)),
        gravity=np.zeros((m, 3)),
        table=np.column_stack(
            [
                own("table_amplitude_m", table.frequency_hz > 0.0),
                2.0 * np.pi * own("table_frequency_hz"),
                own("table_phase_rad"),
            ]
        ),
    )
    for p, name in enumerate(parameters):
        if name == "corner_radius_m":
            # The corners of the inner polyhedron move along straight lines, so that any step is right.
            step = die.corner_radius_m or 0.01 * die.solid.inradius
            sources.vertices[p] = (inner_vertices(die.solid, step) - die.solid.vertices) / step
        elif name in SHIFTS:
            sources.vertices[p] = -SHIFTS[name]
        elif name in _TILTS:
            plane = table.plane
            turned = -cross_matrix(_turn(table).T @ _TILTS[name])
            sources.gravity[p] = turned @ np.array([plane.gx, plane.gy, -plane.g])
    return sources


def _is_isotropic(die: Die) -> bool:
    """Whether one number says how the mass is spread, wherever its centre is."""
    tensor = die.inertia_tensor_kg_m2
    return tensor is None or bool(np.abs(tensor - tensor[0, 0] * np.eye(3)).max() <= 1e-12 * tensor[0, 0])


def _in_world(
    die: Die, table: Table, parameters: Sequence[str], poses: Array, jacobian: Array
) -> tuple[Array, Array, Array]:
    """Positions (n, 3), quaternions (n, 4) and derivatives (n, 6, 12 + m) of the poses, from the table's axes."""
    positions, quaternions = poses[:, :3] + np.array([0.0, 0.0, die.corner_radius_m]), poses[:, 3:]
    if table.tilt_rad:
        turn = _turn(table)
        positions, quaternions = positions @ turn.T, quat_multiply(table.world_from_table, quaternions)
        jacobian = np.concatenate([turn @ jacobian[:, :3], turn @ jacobian[:, 3:]], axis=1)
    for column, name in enumerate(parameters, 12):
        if name == "corner_radius_m":
            jacobian[:, :3, column] += _turn(table)[:, 2]
        elif name in _TILTS:
            jacobian[:, :3, column] += positions @ cross_matrix(_TILTS[name]).T
            jacobian[:, 3:, column] += _TILTS[name]
    return positions, quaternions, jacobian
