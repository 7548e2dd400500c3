"""A throw, event by event: fly to the next touch, apply the impact, and repeat until the throw ends.

**Rest.** Without friction nothing changes the horizontal velocity or ω_z, so only the rest of the energy, E' = m g z +
m v_z²/2 + J (ω_x² + ω_y²)/2, can turn the die over. To leave its lowest face the die must lift its centre over the
nearest edge of that face, to the height d, the distance of that edge from the centre. Once E' < m g d it never can: the
landed face is decided, exactly and without a tolerance, although the die still rattles on it. On a table that
oscillates so weakly that A (2πf)² ≤ g, a die that lies on a face stays there. Friction can convert all of the energy
into a rise of the centre, so with friction the whole of E counts. A slope keeps supplying energy to a sliding die, so
on a slope only a die at rest has landed.

**Spinning.** Without friction ω_z is constant. While the die touches the table with vertex A alone, so is its spin
about the line from A to the centre, b = ω·e, because an impulse at A has no moment about that line. With u the cosine
of the tilt of the line, every such state, in flight or not, satisfies

    E'/m ≥ g R u + (J/m) (b - ω_z u)² / (2 (1 - u²)) = V(u).

V is convex, and E' never grows. Let u* be the tilt at which another vertex can first come as low as A. If V(u*) > E'/m
and the line is steeper than that, it stays steeper: no other vertex ever touches, and the die spins for ever
(SPINNING), whether it still bounces or not. A die that touches with others now and then, ever more faintly, escapes
this proof. It is given up after 1000 √(R/g) without the energy to stand up (SPUN_LONG), and at χ above 0.9, where every
die loses energy slowly, after 0.1/(1 - χ) times as long. A body with several moments of inertia is proved to spin for ever
only on a vertex on an axis of symmetry of its inertia (`engine.asymmetric`).

**Air.** Drag acts against the velocity of the centre and has no moment about it. Along the table's normal it takes k |v|
v_z² from E' in each second, and it leaves ω_z and b as they are. So E' never grows, nor does E, and both proofs hold
against drag word for word. `engine.air` has the flight and its next touch. On the table the drag adds to the weight, and
slows the die.

**Balance.** A die that is exactly balanced on a vertex or an edge stays there (BALANCED). A neighbouring state falls.

**Bouncing.** At χ = 1, and on a table that oscillates hard, a throw may never end (BOUNCING). Such a throw needs a
limit of time or of impacts.

`held_contact` has the method for bounces that follow each other without end. The horizontal drift of a resting die is
not stopped without friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from .. import engine
from ..die import Die
from ..errors import InputError
from ..laws import LEVEL, ImpactLaw, Table
from ..rotations import quat_conjugate
from .asymmetric_throw import throw_asymmetric_die
from .body import body_of, checked_release, kernel_states, packed_state
from .history import throw_from_asymmetric, throw_from_log
from .motion import State, Throw, rotated_state
from .supported import BodyKind, Door, body_kind, needs_asymmetric_kernels, refuse_unsupported

IMPACT_CAP = 10_000_000
"""Impacts after which any throw is stopped: more than any throw below χ = 1 on a table at rest has needed."""

BOUNCING_CAP = 1000
"""Impacts after which a throw that may never end is stopped, if no other limit is given."""


class Ending(Enum):
    """Why a throw ended; the value is a sentence for the user."""

    RESTED = "The die no longer has the energy to leave its lowest face."
    SPINNING = "The die spins for ever on one vertex: no other vertex can touch the table again."
    SPUN_LONG = "The die spun or slid for at least 1000 √(R/g) without coming to rest, and nothing stops it."
    BALANCED = "The die stands exactly balanced on a vertex or an edge."
    BOUNCING = f"The die loses too little energy to come to rest; the throw was stopped after {BOUNCING_CAP} impacts."
    TIME_REACHED = "The requested time was reached."
    IMPACTS_REACHED = "The requested number of impacts was reached; the last flight leads to the next impact."
    CHATTER = "The bounces follow each other without end, and the vertex stays on the table."
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
"""By the codes of the kernels, `engine.types`."""


@dataclass(frozen=True)
class Until:
    """Limits of a throw. With neither of them it runs until its face is decided."""

    time_s: float | None = None
    """[s] on the clock of the release."""
    impacts: int | None = None
    """Number of impacts."""

    def __post_init__(self) -> None:
        if self.time_s is not None and not np.isfinite(self.time_s):
            raise InputError(f"time_s = {self.time_s}: wanted a finite time in seconds, or None for no limit")
        if self.impacts is not None and not (isinstance(self.impacts, int | np.integer) and self.impacts >= 0):
            raise InputError(f"impacts = {self.impacts}: wanted a whole number, 0 or more, or None for no limit")


@dataclass(frozen=True, eq=False)
class ThrowResult:
    """A simulated throw and how it ended."""

    throw: Throw
    """The last flight leads from the last impact to the next touch, or to the requested time."""
    ending: Ending
    landed_face: int | None
    """Number of the face that the die can no longer leave; None if it is not decided."""
    depends_on_numbering: bool = False
    """Whether vertices touched the table at one instant and were struck one after the other, the fastest first, and of equals the
    one with the lowest number: with friction, where no law for several of them at once is known (`touch`)."""

    @property
    def impact_count(self) -> int:
        """Number of impacts; a vertex that is held or released is not one."""
        return len(self.throw.bounces)

    @property
    def end(self) -> State:
        """The state at the end of the last flight."""
        last = self.throw.flights[-1]
        return last.at(last.end_s)


@dataclass(frozen=True)
class Precision:
    """Where accuracy is traded for speed. The defaults are as exact as double precision allows."""

    contact_tolerance_m: float = engine.FINE.contact_tolerance
    """[m] Height at which a vertex touches the table; 0 for rounding only (`touch`)."""
    slowest_bounce: float = engine.FINE.slowest_bounce
    """Speed of the slowest bounce that is simulated before the vertex is held, in units of √(g R) (`held_contact`)."""
    step_turn_rad: float = engine.FINE.step_turn
    """Turn of the die in one step of held contact."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.contact_tolerance_m < np.inf:
            raise InputError(f"contact_tolerance_m = {self.contact_tolerance_m}: wanted a finite height, 0 or more")
        if not 0.0 < self.slowest_bounce < 1.0:
            raise InputError(f"slowest_bounce = {self.slowest_bounce}: wanted a number above 0 and below 1")
        if not 0.0 < self.step_turn_rad <= 1.0:
            raise InputError(f"step_turn_rad = {self.step_turn_rad}: wanted an angle above 0, at most 1 rad")

    @property
    def packed(self) -> engine.Precision:
        """The record that the kernels take."""
        return engine.Precision(self.contact_tolerance_m, self.slowest_bounce, self.step_turn_rad)


EXACT = Precision()
"""The default precision."""


def is_endless(law: ImpactLaw, table: Table) -> bool:
    """Whether a throw may never end: at χ = 1, and on an oscillating table."""
    return bool(law.parameters[0] >= 1.0 or table.moves)


def throw_die(
    die: Die,
    release: State,
    law: ImpactLaw,
    *,
    until: Until = Until(),
    table: Table = LEVEL,
    precision: Precision = EXACT,
    drag_per_m: float = 0.0,
) -> ThrowResult:
    """Follow a die from its release until its face is decided or a limit of `until` is reached.

    With a limit the throw continues after its face is decided, and `landed_face` still names it. Rounded corners touch the
    table with the spheres about the corners of the inner polyhedron. `drag_per_m` is k in v' = g - k |v| v, in 1/m, as of
    `propagate`, from the release to rest. Raises ValueError for a release that is not finite,
    whose quaternion is not of length 1, that lies below the table, or that is later than the end time, for drag
    outside 0 to `laws.MAX_DRAG_PER_M`, and for what `supported` does not combine.
    """
    duration = np.inf if until.time_s is None else float(until.time_s - release.time_s)
    if duration < 0.0:
        raise InputError(f"until time_s = {until.time_s}: wanted a time after the release at {release.time_s} s")
    endless = until == Until() and is_endless(law, table)
    cap = BOUNCING_CAP if endless else IMPACT_CAP
    kind, packed_law = body_kind(die), engine.law_of(law.code, law.parameters)
    plane = table.plane_in_air(drag_per_m)
    refuse_unsupported(Door.THROW, kind, packed_law, has_drag=drag_per_m > 0.0)
    if needs_asymmetric_kernels(kind, packed_law):
        packed_state(release)  # raises for an invalid state while it is still in the axes of the caller
        return _throw_asymmetric(die, release, law, until, duration, table, precision, cap)
    start = checked_release(die, release, table)
    if kind is BodyKind.LOADED:
        start = kernel_states(die, table, packed_state(release)[None])[0]
    setup = engine.Setup(body_of(die), packed_law, plane, precision.packed)
    impacts = engine.NO_LIMIT if until.impacts is None else until.impacts
    code, _, face, end, _, log, knots = engine.run_throw(
        setup, start, float(release.time_s), engine.Limits(duration, impacts, cap, until == Until()), True
    )
    ending = Ending.BOUNCING if endless and code == engine.IMPACT_CAP else ENDINGS[code]
    throw = throw_from_log(die, start, float(release.time_s), log, end, knots, table, drag_per_m)
    return ThrowResult(throw, ending, int(face) + 1 if face >= 0 else None, bool((log[:, 23] < 0.0).any()))


def _throw_asymmetric(
    die: Die,
    release: State,
    law: ImpactLaw,
    until: Until,
    duration_s: float,
    table: Table,
    precision: Precision,
    cap: int,
) -> ThrowResult:
    """The same for an asymmetric die."""
    motion = throw_asymmetric_die(
        die,
        rotated_state(release, quat_conjugate(table.world_from_table)) if table.tilt_rad else release,
        engine.law_of(law.code, law.parameters),
        plane=table.plane,
        precision=precision.packed,
        duration_s=duration_s,
        impacts=until.impacts,
        stop_when_decided=until == Until(),
        impact_cap=cap,
    )
    capped = motion.code == engine.IMPACT_CAP and cap == BOUNCING_CAP
    ending = Ending.BOUNCING if capped else ENDINGS[motion.code]
    in_turn = bool((motion.log[:, 23] < 0.0).any())
    return ThrowResult(throw_from_asymmetric(motion, release, table), ending, motion.landed_face, in_turn)
