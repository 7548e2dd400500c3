"""A shot, lengthened bounce by bounce as long as the model explains what comes.

The motion is chaotic, an error growing about twenty-fold a bounce; so the window grows bounce by bounce, and into each
new flight by few frames first, so that the state is always known well enough for the next step to be nearly linear.
The measured vertex is tried first; where that is unknown, not explained, or followed by too few frames to tell, the
sequences that throws drawn from the fit make by themselves are tried as well, and the best few are kept until later
frames decide.

Nor does it go on where rounding, grown from bounce to bounce, begins to be felt (`MOST_ROUNDING`): after some ten bounces
no double can name the start that makes the throw, while its parameters are long known better than any table is even.

The fit ends at the first bounce that the model cannot explain: where the frames lie more than `MISFIT` times as far
from every such throw as they scatter about free flights. A wrong vertex or a law that does not hold misses by tens;
errors that tracking repeats from frame to frame, which a flight can absorb and a throw cannot, stay below.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model.laws import Restitution
from ...model.throw import Throw
from ..estimation import CLEAN_FRAME, ENOUGH, NEARLY
from ..free import FEWEST_FRAMES, FreeFlights
from .contact_sequences import candidates, measured_sequence, own_sequence, simulated_sequences
from .physics import EFFECTS, RESTITUTIONS, Physics
from .shooting import Shot, clear_of_impacts, linear, mean_squares, shoot, with_physics

MISFIT = 2.5
"""Largest ratio of the residuals of a throw to those of free flights at which the throw still counts as explained."""

MOST_ROUNDING = 1e-5
"""Sigmas by which rounding of the start may move frames where another bounce is still taken in: it grows up to a hundredfold
at each, and from 1e-3 on descents end where they stumble, not where the cost is least."""

_TELLING = 8
"""Frames of a flight that tell one vertex from another; with fewer, rival sequences are carried along."""

_HOPELESS = 20.0
"""Times the allowed mean square at which a sequence is given up before all frames of a flight are in."""

_SAME = 0.01
"""Difference of a coefficient below which two starts are one."""

CLEARLY = 10.0
"""Fall of the cost, in units of a residual's variance, at which a kind of restitution is taken for a preferred one: a
likelihood 150 times as large."""

_USUAL_FRICTION = 0.3

_WELL = 1.5
"""The same ratio below which no other way to explain a flight is looked for."""

_ALIKE = 1e-6
"""Sigmas by which no residual differs between kinds of restitution where no slip stops or turns within an impact."""

_BEAM = 3

_WINDOWS = (4, 12, 40)
"""Frames of a new flight in the first fits of it; the last takes all."""


def through_the_bounces(beam: list[Shot], measured: Throw, free: FreeFlights) -> list[Shot]:
    """Lengthen shots flight by flight while the model explains them: the best shots, the best first."""
    for target in range(beam[0].reached + 1, len(measured.flights)):
        if at_its_limit(beam[0]):
            break
        few = free.sightings.count(target)
        longer: list[Shot] = []
        if few >= FEWEST_FRAMES:
            longer = _lengthened(beam, target, measured, free) or _by_another_way(beam[0], target, measured, free)
        if longer:
            beam = longer
        elif few >= _TELLING:
            break
        # A short flight may belong to a contact that was not resolved: pass over its frames and try the next.
    return beam


def can_go_on(free: FreeFlights, reached: int) -> bool:
    """Whether any flight after this one has frames enough to be fitted."""
    return next_flight(free, reached) is not None


def next_flight(free: FreeFlights, reached: int) -> int | None:
    """The next flight with frames enough to be fitted."""
    later = range(reached + 1, len(free.flights))
    return next((k for k in later if free.sightings.count(k) >= FEWEST_FRAMES), None)


def at_its_limit(shot: Shot) -> bool:
    """Whether one more bounce is more than doubles can carry."""
    return shot.rounding > MOST_ROUNDING


def best_attempt(shot: Shot, measured: Throw, free: FreeFlights) -> Shot | None:
    """The shot nearest to the frames up to the next flight that has any, explained or not."""
    target = next_flight(free, shot.reached)
    while target is not None:
        impacts = measured.impacts[shot.reached : target]
        sequences = dict.fromkeys([*measured_sequence(impacts), *simulated_sequences(shot, target, free)[:2]])
        tried = [reach(shot, sequence, target, free, patient=True) for sequence in sequences]
        reached = [other for other in tried if other is not None]
        if reached:
            return min(reached, key=lambda s: s.mean_square)
        if free.sightings.count(target) >= _TELLING:
            return None
        target = next_flight(free, target)  # a few frames between two impacts may all turn out to touch one
    return None


def loss_scale(free: FreeFlights) -> float:
    """k² of the robust loss: a bad frame is one that is bad beside what frames really scatter."""
    return CLEAN_FRAME * max(1.0, free.variance)


def is_explained(shot: Shot, free: FreeFlights, misfit: float = MISFIT) -> bool:
    """Whether no flight lies farther from the throw than `misfit` times what free flights leave."""
    for k, mean_square in mean_squares(shot).items():
        alone = free.flights[k]
        allowed = max(1.0, free.variance)
        if alone is not None and alone.frames > FEWEST_FRAMES:
            # A blurred flight scatters more than the others; one that hides a bounce far more, which excuses nothing.
            allowed = float(np.clip(alone.variance, allowed, 4.0 * allowed))
        if mean_square > misfit**2 * allowed:
            return False
    return True


def keeps_its_sequence(shot: Shot) -> bool:
    """Whether the fitted throw, left to itself, touches with the vertices that were prescribed."""
    return own_sequence(shot.physics, shot.state, float(shot.sightings.time_s[-1])) == shot.vertices


def well_explained(shot: Shot, free: FreeFlights) -> bool:
    """Whether no other values or kinds need be tried for what the shot explains."""
    return is_explained(shot, free, _WELL)


def starts_with(effect: str, physics: Physics, free: FreeFlights, before: int, after: int) -> list[Physics]:
    """The physics with some of one effect, from where fits of the flights `before` and `after` a bounce find their way:
    first as much as these two show."""
    some = physics.with_some_of(effect)
    if effect == "friction" and (ratio := _slip_ratio(free, before, after)) is not None:
        return [physics.with_effect(effect).with_values(mu=ratio), *some]
    return some


def _slip_ratio(free: FreeFlights, before: int, after: int) -> float | None:
    """Tangential over normal impulse between two flights: where a contact slides throughout, μ. None where it is none."""
    pair = free.flights[before], free.flights[after]
    if pair[0] is None or pair[1] is None:
        return None
    instant = pair[1].flight.start.time_s
    change = pair[1].flight.start.velocity_m_s - pair[0].flight.at(instant).velocity_m_s
    return float(np.hypot(change[0], change[1]) / change[2]) if change[2] > 0.0 else None


def _by_another_way(shot: Shot, target: int, measured: Throw, free: FreeFlights) -> list[Shot]:
    """The shots that explain the frames up to flight `target` from other values of what earlier frames have left open,
    such as friction at a contact that stuck, or with another kind of restitution, which all mean the same until a slip
    stops; none if there is no such way."""
    others = _variants(shot, target, free)
    for likeliest in (True, False):
        found: list[Shot] = []
        for other in others:
            longer = _lengthened([other], target, measured, free, likeliest=likeliest)
            if longer and well_explained(longer[0], free):
                return longer
            found += longer
        if found:
            return _best_of(found)
    return []


def _variants(shot: Shot, target: int, free: FreeFlights) -> list[Shot]:
    """The shot with other kinds of restitution, with other values that explain its own frames, and with both."""
    kinds = [replace(shot, physics=kind) for kind in shot.physics.with_other_restitutions()]
    others: list[Shot] = []
    for effect in shot.physics.effects:
        for physics in starts_with(effect, shot.physics, free, shot.reached, target):
            other = _settled_with(effect, physics, shot, free)
            if is_explained(other, free) and not any(_agree(other, known) for known in (shot, *others)):
                others.append(other)
    both = [replace(other, physics=kind) for other in others for kind in other.physics.with_other_restitutions()]
    return [*kinds, *others, *both]


def _settled_with(effect: str, physics: Physics, shot: Shot, free: FreeFlights) -> Shot:
    """The shot with an effect as it is in `physics`, and all else fitted to that.

    With all of it free from the beginning, a descent may stop at the bend where a slip just stops within an impact.
    """
    k2, held = loss_scale(free), physics.held | set(EFFECTS[effect])
    settled = shoot(
        shot.sightings, with_physics(shot, replace(physics, held=held), k2), shot.vertices, k2, enough=NEARLY
    )
    return with_physics(settled, replace(settled.physics, held=physics.held), k2)


def _agree(one: Shot, other: Shot) -> bool:
    """Whether two shots have the same parameters, within what a fit that is only to lead on tells."""
    return all(abs(value - other.physics.values[name]) < _SAME for name, value in one.physics.values.items())


def ways_of_friction(shot: Shot, free: FreeFlights) -> list[Shot]:
    """The shot as friction is best told by its frames, then others of the same kind that agree with them as well.

    Where no slip stops within an impact there is one way alone. Where one does, more friction may do as well, the least
    cost may lie behind a bend that a descent does not pass, and kinds of restitution differ: of these the first, in the
    order of preference, that no other clearly beats.
    """
    if all(_is_alike(replace(shot, physics=kind), shot) for kind in shot.physics.with_other_restitutions()):
        return [shot]
    k2 = loss_scale(free)
    ways = {kind: [_of_kind(kind, shot, k2)] for kind in RESTITUTIONS}
    for kind in RESTITUTIONS:
        # From elsewhere only where it may change the choice.
        ways[kind] += _elsewhere(kind, shot, free)
        best = min((way for found in ways.values() for way in found), key=lambda way: way.cost(k2))
        enough = best.cost(k2) + CLEARLY * max(1.0, best.mean_square)
        preferred = ways[kind]
        if min(way.cost(k2) for way in preferred) <= enough:
            break
    # Where any friction beyond some does as well, the value given is one that scenes have.
    least = min(way.cost(k2) for way in preferred)
    usual = {id(way): abs(np.log(max(way.physics.values["mu"], _SAME) / _USUAL_FRICTION)) for way in preferred}
    ranked = sorted(preferred, key=lambda way: (way.cost(k2) > least + NEARLY, usual[id(way)]))
    return [way for way in ranked if way.cost(k2) <= enough]


def _of_kind(kind: Restitution, shot: Shot, k2: float) -> Shot:
    """The shot with one kind of restitution, from its own values."""
    if kind == shot.physics.restitution:
        return shot
    physics = replace(shot.physics, restitution=kind)
    return shoot(shot.sightings, with_physics(shot, physics, k2), shot.vertices, k2)


def _elsewhere(kind: Restitution, shot: Shot, free: FreeFlights) -> list[Shot]:
    """The shot with one kind of restitution, from little and from much friction."""
    some = replace(shot.physics, restitution=kind).with_some_of("friction")
    starts = [_settled_with("friction", physics, shot, free) for physics in some]
    return [shoot(shot.sightings, start, shot.vertices, loss_scale(free)) for start in starts]


def _is_alike(other: Shot, shot: Shot) -> bool:
    """Whether another kind of restitution makes no difference to a shot."""
    if other.physics.restitution == shot.physics.restitution:
        return True
    return bool(np.abs(linear(other)[0] - shot.residuals).max() < _ALIKE)


def _lengthened(
    beam: list[Shot], target: int, measured: Throw, free: FreeFlights, *, likeliest: bool = False
) -> list[Shot]:
    """The shots that explain the frames up to flight `target` too, best first; none if no sequence does.

    With `likeliest`, through the measured vertices alone where they are known.
    """
    found: list[Shot] = []
    telling = free.sightings.count(target) >= _TELLING
    for shot in beam:
        tried: set[tuple[int, ...]] = set()
        for group in candidates(shot, measured.impacts[shot.reached : target], target, free):
            for sequence in group:
                if sequence not in tried:
                    tried.add(sequence)
                    longer = reach(shot, sequence, target, free)
                    if longer is not None and is_explained(longer, free):
                        found.append(longer)
            if (telling and any(keeps_its_sequence(longer) for longer in found)) or (likeliest and group):
                break
    return _best_of(found)


def _best_of(found: list[Shot]) -> list[Shot]:
    """The best shot of each sequence, a few of them; throws that take their vertices by themselves come before throws
    that have to be told."""
    ranked = sorted(found, key=lambda shot: (not keeps_its_sequence(shot), shot.mean_square), reverse=True)
    distinct = {shot.vertices: shot for shot in ranked}
    return list(reversed(distinct.values()))[:_BEAM]


def reach(
    shot: Shot, sequence: tuple[int, ...], target: int, free: FreeFlights, *, patient: bool = False
) -> Shot | None:
    """The shot fitted on through more impacts to the end of flight `target`; None if one of them never happens.

    Unless `patient`, None as well as soon as the fit is hopelessly far from the frames.
    """
    vertices = shot.vertices + sequence
    mine = np.flatnonzero(free.sightings.flight == target)
    old = np.flatnonzero(np.isin(free.sightings.flight, np.unique(shot.sightings.flight)))
    k2 = loss_scale(free)
    for count in [*(n for n in _WINDOWS if n < len(mine)), len(mine)]:
        # Few frames say little of the parameters, so the scales of the step before stand in for them.
        seen = free.sightings.where(np.concatenate([old, mine[:count]]))
        shot = shoot(seen, shot, vertices, k2, enough=NEARLY if count < len(mine) else ENOUGH)
        if not patient and max(mean_squares(shot).values()) > _HOPELESS * MISFIT**2 * max(1.0, free.variance):
            return None
    clear = clear_of_impacts(shot)
    if not clear.all():
        shot = shoot(shot.sightings.where(clear), shot, vertices, k2)
    happened = len(shot.way.impact_times_s) == len(vertices) and shot.sightings.count(target) >= FEWEST_FRAMES
    return replace(shot, reached=target) if happened else None
