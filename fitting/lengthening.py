"""A shot, lengthened bounce by bounce as long as the model explains what comes.

The motion is chaotic, an error growing about twenty-fold a bounce; so the window grows bounce by bounce, and into each
new flight by few frames first, so that the state is always known well enough for the next step to be nearly linear.
The measured vertex is tried first; where that is unknown, not explained, or followed by too few frames to tell, the
sequences that throws drawn from the fit make by themselves are tried as well, and the best few are kept until later
frames decide.

The fit ends at the first bounce that the model cannot explain: where the frames lie more than `MISFIT` times as far
from every such throw as they scatter about free flights. A wrong vertex or a law that does not hold misses by tens;
errors that tracking repeats from frame to frame, which a flight can absorb and a throw cannot, stay below.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.motion import Throw
from .flights import FEWEST_FRAMES, FreeFlights
from .robust import CLEAN_FRAME
from .sequences import candidates, measured_sequence, own_sequence, simulated_sequences
from .shots import Shot, clear_of_impacts, mean_squares, shoot

MISFIT = 2.5
"""Largest ratio of the residuals of a throw to those of free flights at which the throw still counts as explained."""

_TELLING = 8
"""Frames of a flight that tell one vertex from another; with fewer, rival sequences are carried along."""

_HOPELESS = 20.0
"""Times the allowed mean square at which a sequence is given up before all frames of a flight are in."""

_BEAM = 3

_WINDOWS = (4, 12, 40)
"""Frames of a new flight in the first fits of it; the last takes all."""


def through_the_bounces(beam: list[Shot], measured: Throw, free: FreeFlights) -> list[Shot]:
    """Lengthen shots flight by flight while the model explains them: the best shots, the best first."""
    for target in range(beam[0].reached + 1, len(measured.flights)):
        few = free.sightings.count(target)
        longer = _lengthened(beam, target, measured, free) if few >= FEWEST_FRAMES else []
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


def best_attempt(shot: Shot, measured: Throw, free: FreeFlights) -> Shot | None:
    """The shot nearest to the frames up to the next flight that has any, explained or not."""
    target = next_flight(free, shot.reached)
    if target is None:
        return None
    impacts = measured.impacts[shot.reached : target]
    sequences = [*measured_sequence(impacts), *simulated_sequences(shot, target, free)[:2]]
    reached = [_reach(shot, sequence, target, free, patient=True) for sequence in sequences]
    return min((shot for shot in reached if shot is not None), key=lambda s: s.mean_square, default=None)


def loss_scale(free: FreeFlights) -> float:
    """k² of the robust loss: a bad frame is one that is bad beside what frames really scatter."""
    return CLEAN_FRAME * max(1.0, free.variance)


def is_explained(shot: Shot, free: FreeFlights) -> bool:
    """Whether no flight lies farther from the throw than `MISFIT` times what free flights leave."""
    for k, mean_square in mean_squares(shot).items():
        alone = free.flights[k]
        allowed = max(1.0, free.variance)
        if alone is not None and alone.frames > FEWEST_FRAMES:
            # A blurred flight scatters more than the others; one that hides a bounce far more, which excuses nothing.
            allowed = float(np.clip(alone.variance, allowed, 4.0 * allowed))
        if mean_square > MISFIT**2 * allowed:
            return False
    return True


def keeps_its_sequence(shot: Shot) -> bool:
    """Whether the fitted throw, left to itself, touches with the vertices that were prescribed."""
    return own_sequence(shot.physics, shot.state, float(shot.sightings.time_s[-1])) == shot.vertices


def _lengthened(beam: list[Shot], target: int, measured: Throw, free: FreeFlights) -> list[Shot]:
    """The shots that explain the frames up to flight `target` too, best first; none if no sequence does."""
    found: list[tuple[bool, float, Shot]] = []
    telling = free.sightings.count(target) >= _TELLING
    for shot in beam:
        tried: set[tuple[int, ...]] = set()
        for group in candidates(shot, measured.impacts[shot.reached : target], target, free):
            for sequence in group:
                if sequence not in tried:
                    tried.add(sequence)
                    longer = _reach(shot, sequence, target, free)
                    if longer is not None and is_explained(longer, free):
                        found.append((not keeps_its_sequence(longer), longer.mean_square, longer))
            if telling and any(not forced for forced, _, _ in found):
                break
    # Throws that take those vertices by themselves come before throws that have to be told.
    distinct = {shot.vertices: shot for _, _, shot in sorted(found, key=lambda f: f[:2], reverse=True)}
    return list(reversed(distinct.values()))[:_BEAM]


def _reach(
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
        shot = shoot(free.sightings.where(np.concatenate([old, mine[:count]])), shot, vertices, k2)
        if not patient and max(mean_squares(shot).values()) > _HOPELESS * MISFIT**2 * max(1.0, free.variance):
            return None
    clear = clear_of_impacts(shot)
    if not clear.all():
        shot = shoot(shot.sightings.where(clear), shot, vertices, k2)
    happened = len(shot.way.impact_times_s) == len(vertices) and shot.sightings.count(target) >= FEWEST_FRAMES
    return replace(shot, reached=target) if happened else None
