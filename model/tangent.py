"""A throw through its bounces, with derivatives.

    propagate(die, start, chi, times_s, *, vertices=None) -> Propagation

The derivatives are those of the exact motion, not differences. In flight, over t,

    δp → δp + t δv,    δ → exp(ωt) δ + t J(ωt) δω,    δv → δv,    δω → δω,

where δ is the rotation vector of a small turn in world axes, R_true = exp(δ) R, and J the left Jacobian of exp
(Barfoot, State Estimation for Robotics, 2017, Eq. 7.77). The instant of a touch follows from its condition h = 0:

    δt = -(δp_z + (δ × r)_z) / u,    u the vertical velocity of the vertex, r its arm.

The disturbances are carried on to the disturbed instant with the velocities before the impact, through the derivative
of the smooth impact (`impacts.SmoothImpact`), and back to the undisturbed instant with the velocities after it (the
saltation matrix of a hybrid system: Aizerman & Gantmacher 1958; Müller 1995). Grazing touches, u → 0, have no
derivative, and near them it is large.

For a fit, prescribe the vertices. Then each flight lasts until that very vertex comes down, even if meanwhile another
dips below the table a little, and the poses are a smooth function of the start as long as none of the impacts vanishes.
Left to itself, the throw takes the first touch each time and its impacts may change order from one trial to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import kernels
from .history import throw_from_log
from .impacts import SmoothImpact
from .motion import State, Throw
from .simulate import Ending, checked_release
from .solids import Die
from .touch import packed_state

Array = NDArray[np.float64]

_IMPACT_CAP = 100_000
"""Of a throw that is left to itself."""


@dataclass(frozen=True, eq=False)
class Propagation:
    """Poses at the times asked for, with their derivatives, and the throw that they belong to."""

    positions_m: Array
    """(n, 3)."""
    quaternions: Array
    """(n, 4) wxyz."""
    jacobian: Array
    """(n, 6, 13). Rows: position [m] and world rotation vector [rad] of the pose at a fixed time. Columns: position,
    world rotation vector, velocity and angular velocity of the start, then χ."""
    throw: Throw
    """With prescribed vertices it holds fewer impacts than vertices where one of them never touches again."""
    impact_jacobian: Array
    """(k, 13) of the instants of the impacts [s], by the same columns."""


def propagate(
    die: Die, start: State, chi: float, times_s: ArrayLike, *, vertices: Sequence[int] | None = None
) -> Propagation:
    """The poses of a throw with smooth impacts at `times_s` (n,) [s], and their derivatives by its start and χ.

    Times may stand in any order, and before the start, where the first flight is extended. `vertices` prescribes which
    vertex touches at each impact: after the last of them the flight goes on, through the table if asked; and where one
    never touches again, all impacts from there on are left out. Without `vertices` the first touch counts every time,
    as in `simulate.throw_die`. Raises ValueError for a start or a χ that no die has, for a vertex that does not exist,
    and, without `vertices`, for a start below the table and for times after the bounces have crowded together.
    """
    SmoothImpact(chi)  # refuses a χ outside [0, 1]
    packed = checked_release(die, start) if vertices is None else packed_state(start)
    sequence = _checked_vertices(die, vertices)
    times = np.atleast_1d(np.asarray(times_s, float))
    if times.ndim != 1 or not np.isfinite(times).all():
        raise ValueError(f"times_s of shape {times.shape}: wanted finite times (n,) in seconds")
    order = np.argsort(times, kind="stable")
    code, poses, jacobian, log, impact_jacobian = kernels.run_tangent(
        die.solid.vertices,
        die.mass_kg,
        die.inertia_kg_m2,
        float(chi),
        packed,
        float(start.time_s),
        times[order],
        sequence,
        vertices is None,
        _IMPACT_CAP,
    )
    if code in (kernels.CHATTER, kernels.IMPACT_CAP):
        ending = Ending.CHATTER if code == kernels.CHATTER else Ending.IMPACT_CAP
        last = log[-1, 0] if len(log) else start.time_s
        raise ValueError(f"times_s up to {times.max():.6g}: {ending.value} The last impact was at {last:.6g} s.")
    back = np.argsort(order, kind="stable")
    end_s = max([start.time_s, *times[-1:], *log[-1:, 0]])
    throw = throw_from_log(die, packed, float(start.time_s), log, end_s)
    poses, jacobian = poses[back], jacobian[back]
    return Propagation(poses[:, :3], poses[:, 3:], jacobian, throw, impact_jacobian)


def _checked_vertices(die: Die, vertices: Sequence[int] | None) -> NDArray[np.int64]:
    """The prescribed vertices as an array (k,); empty for None."""
    sequence = np.array([] if vertices is None else list(vertices), np.int64)
    count = len(die.solid.vertices)
    if ((sequence < 0) | (sequence >= count)).any():
        raise ValueError(f"vertices = {sequence.tolist()}: wanted indices from 0 to {count - 1}")
    return sequence
