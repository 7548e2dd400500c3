"""Extension bounce by bounce: a trajectory is continued as long as the model explains the next flight.

The motion is chaotic: an error grows about twenty-fold at a bounce. The fitted frames therefore grow bounce by bounce,
and within a new flight from few frames to all, so that each fit starts where the problem is nearly linear.

The measured vertex is tried first. If it is unknown, fails, or is followed by too few frames to distinguish vertices, the
sequences that throws drawn from the fit make by themselves are tried too. The best few trajectories are kept until later
frames decide (beam search).

The extension ends

- where rounding, grown from bounce to bounce, becomes visible (`MAX_ROUNDING`). After some ten bounces no double can name
  the initial state of the throw, while its parameters are long known better than any table is even.
- at the first bounce that the model cannot explain: the frames lie more than `Choices.misfit_limit` times as far from
  every trajectory as they scatter about free flights. A wrong vertex or a wrong law misses by tens. Errors that tracking
  repeats from frame to frame, which a flight absorbs and a throw does not, stay below.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...model.laws import Restitution
from ...model.throw import Throw
from ..estimation import COARSE_TOLERANCE, COST_TOLERANCE
from ..free import MIN_FRAMES, FreeFlights
from .contact_sequences import Vertices, candidates, measured_sequence, own_sequence, simulated_sequences
from .physics import EFFECTS, RESTITUTIONS, Physics
from .shooting import (
    Trajectory,
    clear_of_impacts,
    fit_trajectory,
    linearised,
    mean_squares,
    refitted,
    refitted_with,
    with_physics,
)

_GOOD_MISFIT = 1.5
"""The same ratio below which no other explanation of a flight is looked for."""

_HOPELESS = 20.0
"""Times the allowed mean square at which a sequence is dropped before all frames of a flight are fitted."""

_EXCUSED_VARIANCE = 4.0
"""Most by which a flight's own variance may exceed that of all flights and still excuse residuals: a blurred flight scatters
more than the others, one that hides a bounce far more."""

MAX_ROUNDING = 1e-5
"""Shift of the frames [sigma] by rounding of the initial state up to which another bounce is added. It grows up to a
hundredfold at each, and beyond 1e-3 descents end at random places, not at the least cost."""

_SUFFICIENT_FRAMES = 8
"""Frames of a flight that distinguish one vertex from another; with fewer, competing sequences are kept."""

_WINDOW_FRAMES = (4, 12, 40)
"""Frames of a new flight in its first fits; the last fit takes all."""

_BEAM_WIDTH = 3
"""Trajectories kept until later frames decide; each takes as long to extend as the first."""

_ATTEMPTED_SEQUENCES = 2
"""Simulated sequences through which the best attempt at an unexplained flight is looked for."""

_SAME_VALUE = 0.01
"""Difference of a coefficient below which two starts are the same."""

_NEGLIGIBLE_RESIDUAL = 1e-6
"""Difference of all residuals [sigma] below which two definitions of restitution are the same: no slip stops or turns within
an impact."""

CLEAR_DIFFERENCE = 10.0
"""Fall of the cost, in units of a residual's variance, for which a preferred definition of restitution is given up: a
likelihood 150 times as large."""


def extend_through_bounces(beam: list[Trajectory], measured: Throw, free: FreeFlights) -> list[Trajectory]:
    """Extend trajectories flight by flight while the model explains them. Returns the best trajectories, best first."""
    for target in range(beam[0].reached + 1, len(measured.flights)):
        if at_its_limit(beam[0]):
            break
        frames = free.observations.count(target)
        longer: list[Trajectory] = []
        if frames >= MIN_FRAMES:
            longer = _extended(beam, target, measured, free) or _extended_from_variants(beam[0], target, measured, free)
        if longer:
            beam = longer
        elif frames >= _SUFFICIENT_FRAMES:
            break
        # A short flight may belong to an unresolved contact: its frames are skipped, and the next flight is tried.
    return beam


def can_go_on(free: FreeFlights, reached: int) -> bool:
    """Whether any later flight has enough frames for a fit."""
    return next_flight(free, reached) is not None


def next_flight(free: FreeFlights, reached: int) -> int | None:
    """The next flight with enough frames for a fit."""
    later = range(reached + 1, len(free.flights))
    return next((k for k in later if free.observations.count(k) >= MIN_FRAMES), None)


def at_its_limit(trajectory: Trajectory) -> bool:
    """Whether double precision cannot carry the fit through another bounce."""
    return trajectory.rounding > MAX_ROUNDING


def best_attempt(trajectory: Trajectory, measured: Throw, free: FreeFlights) -> Trajectory | None:
    """The trajectory nearest to the frames up to the next flight that has any, explained or not."""
    target = next_flight(free, trajectory.reached)
    while target is not None:
        impacts = measured.impacts[trajectory.reached : target]
        simulated = simulated_sequences(trajectory, target, free)[:_ATTEMPTED_SEQUENCES]
        sequences = dict.fromkeys([*measured_sequence(impacts), *simulated])
        tried = [extend(trajectory, sequence, target, free, exhaustive=True) for sequence in sequences]
        reached = [other for other in tried if other is not None]
        if reached:
            return min(reached, key=lambda other: other.mean_square)
        if free.observations.count(target) >= _SUFFICIENT_FRAMES:
            return None
        target = next_flight(free, target)  # a few frames between two impacts may all be too close to one
    return None


def is_explained(
    trajectory: Trajectory, free: FreeFlights, misfit: float | None = None, *, least_variance: float = 1.0
) -> bool:
    """Whether no flight lies farther from the trajectory than `misfit` times what free flights leave, taken to be no less than
    `least_variance`; by default the limit that was chosen for these."""
    misfit = free.choices.misfit_limit if misfit is None else misfit
    for k, mean_square in mean_squares(trajectory).items():
        alone = free.flights[k]
        allowed = max(least_variance, free.variance)
        if alone is not None and alone.frames > MIN_FRAMES:
            allowed = float(np.clip(alone.variance, allowed, _EXCUSED_VARIANCE * allowed))
        if mean_square > misfit**2 * allowed:
            return False
    return True


def well_explained(trajectory: Trajectory, free: FreeFlights) -> bool:
    """Whether no other values or definitions of restitution need be tried for what the trajectory explains: it does so as well as
    free flights do, however large the errors are that frames state. Where these are stated too large, a wrong definition of
    restitution lies within them."""
    return is_explained(trajectory, free, _GOOD_MISFIT, least_variance=0.0)


def _explains(trajectory: Trajectory, free: FreeFlights, sequence: Vertices, measured: Sequence[Vertices]) -> bool:
    """Whether a trajectory through a sequence of vertices explains its frames, given what was `measured` of it: one or nothing.

    A wrong law comes near the frames by other vertices. A sequence that was not measured must therefore explain its frames well,
    and one that leaves a measured bounce out as well as free flights do, however large the errors are that frames state. A bounce
    more may have lain between two frames."""
    if sequence in measured:
        return is_explained(trajectory, free)
    leaves_out = any(len(sequence) < len(other) for other in measured)
    return is_explained(trajectory, free, _GOOD_MISFIT, least_variance=0.0 if leaves_out else 1.0)


def keeps_its_sequence(trajectory: Trajectory) -> bool:
    """Whether the fitted throw, simulated without prescription, touches with the prescribed vertices."""
    end_s = float(trajectory.observations.time_s[-1])
    return own_sequence(trajectory.physics, trajectory.state, end_s) == trajectory.vertices


def extend(
    trajectory: Trajectory, sequence: Vertices, target: int, free: FreeFlights, *, exhaustive: bool = False
) -> Trajectory | None:
    """The trajectory extended through more impacts to the end of flight `target`; None if one of them never happens.

    Also None, unless `exhaustive`, as soon as the fit is hopelessly far from the frames.
    """
    vertices = trajectory.vertices + sequence
    new = np.flatnonzero(free.observations.flight == target)
    old = np.flatnonzero(np.isin(free.observations.flight, np.unique(trajectory.observations.flight)))
    k2 = free.huber_threshold
    for count in [*(n for n in _WINDOW_FRAMES if n < len(new)), len(new)]:
        # Few frames have little information on the parameters, so the scales of the step before stand in for it.
        window = free.observations.where(np.concatenate([old, new[:count]]))
        tolerance = COARSE_TOLERANCE if count < len(new) else COST_TOLERANCE
        trajectory = fit_trajectory(window, trajectory, vertices, k2, tolerance=tolerance)
        worst = max(mean_squares(trajectory).values())
        if not exhaustive and worst > _HOPELESS * free.choices.misfit_limit**2 * max(1.0, free.variance):
            return None
    clear = clear_of_impacts(trajectory)
    if not clear.all():
        trajectory = fit_trajectory(trajectory.observations.where(clear), trajectory, vertices, k2)
    happened = len(trajectory.propagation.impact_times_s) == len(vertices)
    followed = trajectory.observations.count(target) >= MIN_FRAMES
    return replace(trajectory, reached=target) if happened and followed else None


def _extended(
    beam: list[Trajectory], target: int, measured: Throw, free: FreeFlights, *, likeliest: bool = False
) -> list[Trajectory]:
    """The trajectories that explain the frames up to flight `target` too, best first; none if no sequence does.

    With `likeliest`, only through the measured vertices where they are known.
    """
    found: list[Trajectory] = []
    sufficient = free.observations.count(target) >= _SUFFICIENT_FRAMES
    for trajectory in beam:
        tried: set[Vertices] = set()
        own: list[Trajectory] = []
        impacts = measured.impacts[trajectory.reached : target]
        known = measured_sequence(impacts)
        for group in candidates(trajectory, impacts, target, free):
            for sequence in group:
                if sequence not in tried:
                    tried.add(sequence)
                    longer = extend(trajectory, sequence, target, free)
                    if longer is not None and _explains(longer, free, sequence, known):
                        own.append(longer)
            if (sufficient and any(keeps_its_sequence(longer) for longer in own)) or (likeliest and group):
                break
        found += own
    return _best_of(found)


def _best_of(found: list[Trajectory]) -> list[Trajectory]:
    """The best trajectory of each sequence, a few of them; those that keep their sequence without prescription come first."""
    ranked = sorted(found, key=lambda one: (not keeps_its_sequence(one), one.mean_square), reverse=True)
    distinct = {trajectory.vertices: trajectory for trajectory in ranked}
    return list(reversed(distinct.values()))[:_BEAM_WIDTH]


def _extended_from_variants(
    trajectory: Trajectory, target: int, measured: Throw, free: FreeFlights
) -> list[Trajectory]:
    """The trajectories that explain the frames up to flight `target` from a variant of this one; none if no variant does.

    Earlier frames leave some values open, such as friction at a contact that stuck, and do not distinguish definitions of
    restitution before a slip stops.
    """
    variants = _variants(trajectory, target, free)
    for likeliest in (True, False):
        found: list[Trajectory] = []
        for variant in variants:
            longer = _extended([variant], target, measured, free, likeliest=likeliest)
            if longer and well_explained(longer[0], free):
                return longer
            found += longer
        if found:
            return _best_of(found)
    return []


def _variants(trajectory: Trajectory, target: int, free: FreeFlights) -> list[Trajectory]:
    """The trajectory by every definition of restitution, with its own values and with others that explain its frames.

    Each definition is fitted by itself: the χ of one does not fit another, nor does the friction from which on a contact sticks.
    """
    found = [trajectory]
    for kind in (trajectory.physics, *trajectory.physics.with_other_restitutions()):
        own = _with_restitution(kind.restitution, trajectory, free.huber_threshold)
        tried = [own]
        for effect in kind.effects:
            starts = starts_with(effect, own.physics, free, trajectory.reached, target)
            tried += [_refitted_from(effect, physics, own, free) for physics in starts]
        for other in tried:
            if is_explained(other, free) and not any(_same_parameters(other, known) for known in found):
                found.append(other)
    return found[1:]


def starts_with(effect: str, physics: Physics, free: FreeFlights, before: int, after: int) -> list[Physics]:
    """The physics with one effect at values from which fits converge: first the value that the flights `before` and
    `after` a bounce show, then typical ones."""
    typical = physics.with_typical_values(effect)
    if effect == "friction" and (ratio := _slip_ratio(free, before, after)) is not None:
        return [physics.with_effect(effect).with_values(mu=ratio), *typical]
    return typical


def _slip_ratio(free: FreeFlights, before: int, after: int) -> float | None:
    """Tangential over normal impulse between two flights, which is μ where a contact slides throughout; None without one."""
    one, other = free.flights[before], free.flights[after]
    if one is None or other is None:
        return None
    instant = other.flight.start.time_s
    change = other.flight.start.velocity_m_s - one.flight.at(instant).velocity_m_s
    return float(np.hypot(change[0], change[1]) / change[2]) if change[2] > 0.0 else None


def _refitted_from(effect: str, physics: Physics, trajectory: Trajectory, free: FreeFlights) -> Trajectory:
    """The trajectory with an effect held as it is in `physics`, and everything else fitted to that.

    With everything free from the start, a descent may stop at the bend where a slip just stops within an impact.
    """
    k2, held = free.huber_threshold, physics.held | set(EFFECTS[effect])
    fitted = refitted_with(trajectory, replace(physics, held=held), k2, tolerance=COARSE_TOLERANCE)
    return with_physics(fitted, replace(fitted.physics, held=physics.held), k2)


def _same_parameters(one: Trajectory, other: Trajectory) -> bool:
    """Whether two trajectories have one definition of restitution and the same parameters, within the accuracy of a
    preliminary fit."""
    if one.physics.restitution != other.physics.restitution:
        return False
    return all(abs(value - other.physics.values[name]) < _SAME_VALUE for name, value in one.physics.values.items())


def definitions_differ(trajectory: Trajectory, free: FreeFlights) -> bool:
    """Whether another definition of restitution makes a difference to the residuals: a slip stops or turns within an impact."""
    kinds = [replace(trajectory, physics=kind) for kind in trajectory.physics.with_other_restitutions()]
    return not all(_same_residuals(kind, trajectory, free) for kind in kinds)


def friction_alternatives(
    trajectory: Trajectory,
    free: FreeFlights,
    *,
    by_every_definition: bool = False,
    followed: Sequence[Trajectory] = (),
) -> list[Trajectory]:
    """The trajectory with the friction that its frames support best, then others that agree with them as well. Where laws that
    follow the course of the slip leave something unexplained, the algebraic law is taken if it clearly beats them. `followed` are
    trajectories by other definitions of restitution as far as this one."""
    ranked = _friction_by_course(trajectory, free, by_every_definition=by_every_definition, followed=followed)
    if well_explained(ranked[0], free):
        return ranked
    k2 = free.huber_threshold
    trials = [_with_restitution("algebraic", ranked[0], k2), *_from_other_friction("algebraic", ranked[0], free)]
    algebraic = min(trials, key=lambda one: one.cost(k2))
    is_clear = algebraic.cost(k2) + CLEAR_DIFFERENCE * max(1.0, algebraic.mean_square) < ranked[0].cost(k2)
    return [algebraic] if is_clear else ranked


def _friction_by_course(
    trajectory: Trajectory, free: FreeFlights, *, by_every_definition: bool, followed: Sequence[Trajectory]
) -> list[Trajectory]:
    """`friction_alternatives` among the definitions of restitution that end one course of the slip.

    Where no slip stops within an impact there is one alternative. Where one does, more friction may fit equally well, the
    least cost may lie behind a bend that a descent does not pass, and the definitions of restitution differ. The first
    definition, in the order of `RESTITUTIONS`, is taken that no other clearly beats. `by_every_definition` adds the others that
    are not clearly beaten, the best trajectory of each.
    """
    if not definitions_differ(trajectory, free):
        return [trajectory]
    k2 = free.huber_threshold
    found = {kind: [_with_restitution(kind, trajectory, k2)] for kind in RESTITUTIONS}
    for other in followed:
        if other.physics.restitution in found:
            found[other.physics.restitution].append(fit_trajectory(trajectory.observations, other, other.vertices, k2))
    for kind in RESTITUTIONS if by_every_definition else ():
        found[kind] += _from_other_friction(kind, trajectory, free)
    for kind in RESTITUTIONS:
        # Other starts only for the definitions that may still be chosen.
        found[kind] += [] if by_every_definition else _from_other_friction(kind, trajectory, free)
        best = min((one for fits in found.values() for one in fits), key=lambda one: one.cost(k2))
        allowed = best.cost(k2) + CLEAR_DIFFERENCE * max(1.0, best.mean_square)
        preferred = found[kind]
        if min(one.cost(k2) for one in preferred) <= allowed:
            break
    # Where any friction above a limit fits equally well, the value nearest to that of usual scenes is reported.
    least, usual = min(one.cost(k2) for one in preferred), free.choices.usual_friction
    rank = {
        id(one): one.cost(k2) if usual is None else abs(np.log(max(one.physics.values["mu"], _SAME_VALUE) / usual))
        for one in preferred
    }
    ranked = sorted(preferred, key=lambda one: (one.cost(k2) > least + COARSE_TOLERANCE, rank[id(one)]))
    others = [min(found[kind], key=lambda one: one.cost(k2)) for kind in RESTITUTIONS if found[kind] is not preferred]
    ranked += others if by_every_definition else []
    return [one for one in ranked if one.cost(k2) <= allowed]


def _with_restitution(kind: Restitution, trajectory: Trajectory, k2: float) -> Trajectory:
    """The trajectory with one definition of restitution, fitted from its own values."""
    if kind == trajectory.physics.restitution:
        return trajectory
    return refitted_with(trajectory, replace(trajectory.physics, restitution=kind), k2)


def _from_other_friction(kind: Restitution, trajectory: Trajectory, free: FreeFlights) -> list[Trajectory]:
    """The trajectory with one definition of restitution, fitted from typical values of friction, small to large."""
    typical = replace(trajectory.physics, restitution=kind).with_typical_values("friction")
    starts = [_refitted_from("friction", physics, trajectory, free) for physics in typical]
    return [refitted(start, free.huber_threshold) for start in starts]


def _same_residuals(other: Trajectory, trajectory: Trajectory, free: FreeFlights) -> bool:
    """Whether another definition of restitution makes no difference to the residuals."""
    if other.physics.restitution == trajectory.physics.restitution:
        return True
    residuals = linearised(other, free.huber_threshold).of_frames
    return bool(np.abs(residuals - trajectory.residuals).max() < _NEGLIGIBLE_RESIDUAL)
