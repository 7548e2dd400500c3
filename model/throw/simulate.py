"""A throw, event by event: fly to the next touch, bounce, and so on until something ends it.

**Rest.** Without friction nothing changes the horizontal velocity or ω_z, so only the rest of the energy,
E' = m g z + m v_z²/2 + J (ω_x² + ω_y²)/2, can turn the die over. To leave its lowest face the die must lift its centre
over the nearest edge of that face, at the height d (the distance of the edge from the centre). Once E' < m g d it
never can: the landed face is decided, exactly and without a tolerance, although the die still rattles on it. On a table
that oscillates so weakly that A (2πf)² ≤ g, a die that lies on a face does so for ever. Friction can turn all of the
energy into what lifts the die, so that with it the whole of E counts; and on a slope, which goes on feeding the slip,
only a die that stands still has landed.

**Spinning.** Without friction ω_z stays, and while the die touches the table with vertex A alone, so does its spin about
the line from A to the centre, b = ω·e (an impulse at A has no moment about it). The line leans by the angle whose
cosine is u, and in every such state, in flight or not,

    E'/m ≥ g R u + (J/m) (b - ω_z u)² / (2 (1 - u²)) = V(u).

V is convex, and E' never grows. So where V(u*) > E'/m at the lean u* at which another vertex can first come as low as
A, and the line stands steeper than that, it does so for ever: no other vertex ever touches, and the die is a top
(SPINNING), whether it still hops or not. A die that touches with others now and then, ever more faintly, escapes this
proof; it is given up after 1000 √(R/g) without the energy to stand up and more, and says so (SPUN_LONG). At χ above
0.9, where every die takes long to calm down, it is given 0.1/(1 - χ) times as long.

**Standing.** Exactly balanced on a vertex or an edge, a die stays there (BALANCED). A neighbour of that state falls.

**Bouncing.** At χ = 1, and on a table that oscillates hard, a throw may go on for ever (BOUNCING): ask for a time or a
number of impacts.

The bounces that crowd together without end are the subject of `contact`. The horizontal drift of a resting die is not
stopped where nothing rubs.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from .. import engine
from ..die import Die
from ..laws import LEVEL, ImpactLaw, Table
from ..rotations import matrix_from_quat, quat_conjugate
from .asymmetric_throw import throw_asymmetric_die
from .body import body_of, touching_vertices
from .history import rotated_state, throw_from_asymmetric, throw_from_log
from .motion import State, Throw
from .touch import packed_state

Array = NDArray[np.float64]

IMPACT_CAP = 10_000_000
"""More impacts than any throw below χ = 1 on a table at rest was seen to need; one that reaches them says so."""
BOUNCING_CAP = 1000
"""Impacts after which a throw that may never end is left, when no other limit was asked for."""

_DEEPEST = 1e-9
"""Part of the circumradius by which a vertex may start below the table: rounding of a pose written with ten digits."""


class Ending(Enum):
    """Why a throw ended; the value says it in a sentence."""

    RESTED = "The die no longer has the energy to leave its lowest face."
    SPINNING = "The die spins for ever as a top on one vertex: no other can touch the table again."
    SPUN_LONG = (
        "The die spun or slid on without coming to rest for at least 1000 times the square root of R/g, and nothing "
        "stops it."
    )
    BALANCED = "The die stands exactly balanced on a vertex or an edge."
    BOUNCING = (
        f"The die bounces on without losing what would bring it to rest; it was left after {BOUNCING_CAP} impacts."
    )
    TIME_REACHED = "The time asked for was reached."
    IMPACTS_REACHED = "The number of impacts asked for was reached; the last flight leads to the next one."
    CHATTER = "The bounces crowd together without end, and the vertex stays on the table."
    IMPACT_CAP = f"The throw was stopped after {IMPACT_CAP} impacts; ask for a time or a number of impacts."


ENDINGS = {
    engine.RESTED: Ending.RESTED,
    engine.SPINNING: Ending.SPINNING,
    engine.TIMED_OUT: Ending.SPUN_LONG,
    engine.BALANCED: Ending.BALANCED,
    engine.TIME_REACHED: Ending.TIME_REACHED,
    engine.IMPACTS_REACHED: Ending.IMPACTS_REACHED,
    engine.CHATTER: Ending.CHATTER,
    engine.IMPACT_CAP: Ending.IMPACT_CAP,
}
"""By the codes of the kernels."""


@dataclass(frozen=True)
class Until:
    """When to stop at the latest. With neither limit the throw runs until its face is decided."""

    time_s: float | None = None
    """[s] on the clock of the release."""
    impacts: int | None = None
    """Number of impacts."""

    def __post_init__(self) -> None:
        if self.time_s is not None and not np.isfinite(self.time_s):
            raise ValueError(f"time_s = {self.time_s}: wanted a finite time in seconds, or None for no limit")
        if self.impacts is not None and not (isinstance(self.impacts, int | np.integer) and self.impacts >= 0):
            raise ValueError(f"impacts = {self.impacts}: wanted 0 or more, a whole number, or None for no limit")


@dataclass(frozen=True, eq=False)
class ThrowResult:
    """A simulated throw and how it ended."""

    throw: Throw
    """The last flight leads from the last impact to the next touch, or to the time asked for."""
    ending: Ending
    landed_face: int | None
    """Number of the face that the die can no longer leave; None while that is open."""

    @property
    def impact_count(self) -> int:
        """Impacts of the throw; that a vertex is held or let go is none."""
        return len(self.throw.bounces)

    @property
    def end(self) -> State:
        """The state at the end of the last flight."""
        last = self.throw.flights[-1]
        return last.at(last.end_s)


@dataclass(frozen=True)
class Precision:
    """Where speed is traded for accuracy. The defaults are as exact as doubles allow; see `contact` and `touch`."""

    contact_tolerance_m: float = engine.FINE.contact_tolerance
    """[m] a vertex this near the table touches; 0 for no farther than rounding."""
    slowest_bounce: float = engine.FINE.slowest_bounce
    """Speed of the slowest bounce that is simulated before the vertex is held, in units of √(g R)."""
    step_turn_rad: float = engine.FINE.step_turn
    """Turn of the die in one step of held contact."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.contact_tolerance_m < np.inf:
            raise ValueError(f"contact_tolerance_m = {self.contact_tolerance_m}: wanted a finite height, 0 or more")
        if not 0.0 < self.slowest_bounce < 1.0:
            raise ValueError(f"slowest_bounce = {self.slowest_bounce}: wanted a number above 0 and below 1")
        if not 0.0 < self.step_turn_rad <= 1.0:
            raise ValueError(f"step_turn_rad = {self.step_turn_rad}: wanted an angle above 0, at most 1 rad")


EXACT = Precision()


def throw_die(
    die: Die,
    release: State,
    law: ImpactLaw,
    *,
    until: Until = Until(),
    table: Table = LEVEL,
    precision: Precision = EXACT,
) -> ThrowResult:
    """Follow a die from its release, until its end is decided or a limit of `until` is reached.

    With a limit the throw goes on after its face is decided; `landed_face` then still names it. Rounded corners touch
    the table with the spheres about the corners of the inner polyhedron. Raises ValueError for a release that no die
    has: not finite, a quaternion not of length 1, below the table, or after the time at which the throw shall end.
    """
    duration = np.inf if until.time_s is None else float(until.time_s - release.time_s)
    if duration < 0.0:
        raise ValueError(f"until time_s = {until.time_s}: wanted a time after the release at {release.time_s} s")
    endless = until == Until() and (law.parameters[0] >= 1.0 or table.moves)
    cap = BOUNCING_CAP if endless else IMPACT_CAP
    if not die.is_spherical_top:
        packed_state(release)  # refuses what is no state, in the words of the caller's own axes
        return _throw_top(die, release, law, until, duration, table, precision, cap)
    start = checked_release(die, release, table)
    code, _, face, end, _, log, knots = engine.run_throw(
        body_of(die),
        engine.law_of(law.code, law.parameters),
        table.plane,
        engine.Precision(precision.contact_tolerance_m, precision.slowest_bounce, precision.step_turn_rad),
        start,
        float(release.time_s),
        duration,
        np.iinfo(np.int64).max if until.impacts is None else until.impacts,
        until == Until(),
        cap,
        True,
    )
    ending = Ending.BOUNCING if endless and code == engine.IMPACT_CAP else ENDINGS[code]
    throw = throw_from_log(die, start, float(release.time_s), log, end, knots, table)
    return ThrowResult(throw, ending, int(face) + 1 if face >= 0 else None)


def _throw_top(
    die: Die,
    release: State,
    law: ImpactLaw,
    until: Until,
    duration_s: float,
    table: Table,
    precision: Precision,
    cap: int,
) -> ThrowResult:
    """The same for a die that is no spherical top; see `tops`."""
    motion = throw_asymmetric_die(
        die,
        rotated_state(release, quat_conjugate(table.world_from_table)) if table.tilt_rad else release,
        engine.law_of(law.code, law.parameters),
        plane=table.plane,
        precision=engine.Precision(precision.contact_tolerance_m, precision.slowest_bounce, precision.step_turn_rad),
        duration_s=duration_s,
        impacts=until.impacts,
        stop_when_decided=until == Until(),
        impact_cap=cap,
    )
    capped = motion.code == engine.IMPACT_CAP and cap == BOUNCING_CAP
    ending = Ending.BOUNCING if capped else ENDINGS[motion.code]
    return ThrowResult(throw_from_asymmetric(motion, release, table), ending, motion.landed_face)


def checked_release(die: Die, release: State, table: Table = LEVEL) -> Array:
    """The release as the kernels have it (13,): in the table's axes, the height less the radius of the corners.

    Raises ValueError where no die can be released so.
    """
    start = packed_state(release)
    if table.tilt_rad:
        start = packed_state(rotated_state(release, quat_conjugate(table.world_from_table)))
    start[2] -= die.corner_radius_m
    heights = touching_vertices(die) @ matrix_from_quat(start[3:7])[2] + start[2]
    lowest = float(heights.min()) - engine.table_height(table.plane, float(release.time_s))
    if lowest < -_DEEPEST * die.solid.circumradius:
        raise ValueError(
            f"position_m = {np.asarray(release.position_m).tolist()}: the lowest vertex lies {-lowest:.3g} m below the "
            "table; raise the die"
        )
    return start
