"""Which vertices touched between two flights: what tracking measured, and what throws near the fit do by themselves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from ...model.throw import Impact, State
from ..free import FreeFlights, moved_state
from .physics import Physics
from .shooting import Shot

Array = NDArray[np.float64]
Vertices = tuple[int, ...]

_DRAWS = 32

_MOST_IMPACTS = 10_000
"""Of a draw until a frame; one that chatters ends in held contact long before."""


def candidates(shot: Shot, impacts: Sequence[Impact], target: int, free: FreeFlights) -> Iterator[list[Vertices]]:
    """Sequences from the end of a shot to flight `target`, in groups: the likeliest group first, to be tried as a whole."""
    yield measured_sequence(impacts)
    yield _listed_sequences(impacts)
    yield simulated_sequences(shot, target, free)
    yield [()]  # tracking may have taken a few bad frames for a bounce


def measured_sequence(impacts: Sequence[Impact]) -> list[Vertices]:
    """The vertices as measured, if each impact has just one."""
    single = all(impact.contact == "vertex" and len(impact.vertices) == 1 for impact in impacts)
    return [tuple(impact.vertices[0] for impact in impacts)] if single else []


def _listed_sequences(impacts: Sequence[Impact]) -> list[Vertices]:
    """Ends of a measured edge or corners of a face, one or two of them, one after the other."""
    if any(not impact.vertices for impact in impacts):
        return []
    options = [[*((v,) for v in impact.vertices), *permutations(impact.vertices, 2)] for impact in impacts]
    return [sum(parts, ()) for parts in product(*options)][:24]


def simulated_sequences(shot: Shot, target: int, free: FreeFlights) -> list[Vertices]:
    """What throws drawn from the fit do by themselves until the first frame of the target flight, the commonest first.

    Each also without its last impacts: a draw may be early.
    """
    until_s = float(free.sightings.time_s[free.sightings.flight == target][0])
    spread = solve_triangular(shot.root, np.eye(len(shot.root))) * np.sqrt(max(1.0, free.variance))
    rng = np.random.default_rng(0)
    seen: Counter[Vertices] = Counter()
    done = len(shot.vertices)
    for k in range(_DRAWS):
        x = spread @ rng.standard_normal(len(spread)) if k else np.zeros(len(spread))
        sequence = own_sequence(shot.physics.moved(x[12:]), moved_state(shot.state, x[:12]), until_s)
        if sequence[:done] == shot.vertices:
            for end in range(done + 1, len(sequence) + 1):
                seen[sequence[done:end]] += 1 if end < len(sequence) else 2
    return [sequence for sequence, _ in seen.most_common(8)]


def own_sequence(physics: Physics, start: State, until_s: float) -> Vertices:
    """The vertices with which a throw left to itself strikes until a time on the track's clock, up to where it stops
    bouncing; none for a start below the table, from which there is no throw."""
    end_s = physics.clock * until_s
    run = physics.run(start, end_s=end_s, impacts=_MOST_IMPACTS, keep=True)
    if run is None:
        return ()
    struck = run.struck
    held = np.flatnonzero(struck < 0)
    return tuple(int(vertex) for vertex in struck[: held[0] if len(held) else None])
