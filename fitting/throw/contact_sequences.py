"""Sequences of vertices that may have touched between two flights: measured ones, and those of simulated throws."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from ...model.throw import Impact, State
from ...tracking.flights import perturbed
from ..free import FreeFlights
from .physics import Physics
from .shooting import Trajectory

Array = NDArray[np.float64]
Vertices = tuple[int, ...]

_DRAWS = 32
"""Throws drawn from a fit for the sequences that they make."""

_MAX_SIMULATED = 8
"""Simulated sequences that are tried: the most frequent ones."""

_MAX_LISTED = 24
"""Sequences tried that a measured edge or face allows; four corners have sixteen single and ordered pairs."""

_MAX_IMPACTS = 10_000
"""Impacts of a draw before a given time; a die that chatters reaches held contact long before."""


def candidates(
    trajectory: Trajectory, impacts: Sequence[Impact], target: int, free: FreeFlights
) -> Iterator[list[Vertices]]:
    """Sequences from the end of a trajectory to flight `target`, in groups to be tried as a whole, the likeliest first."""
    yield measured_sequence(impacts)
    yield _listed_sequences(impacts)
    yield simulated_sequences(trajectory, target, free)
    yield [()]  # tracking may have taken a few bad frames for a bounce


def measured_sequence(impacts: Sequence[Impact]) -> list[Vertices]:
    """The vertices as measured, if each impact has just one."""
    single = all(impact.contact == "vertex" and len(impact.vertices) == 1 for impact in impacts)
    return [tuple(impact.vertices[0] for impact in impacts)] if single else []


def _listed_sequences(impacts: Sequence[Impact]) -> list[Vertices]:
    """Ends of a measured edge or corners of a face, one or two of them in either order."""
    if any(not impact.vertices for impact in impacts):
        return []
    options = [[*((v,) for v in impact.vertices), *permutations(impact.vertices, 2)] for impact in impacts]
    return [sum(parts, ()) for parts in product(*options)][:_MAX_LISTED]


def simulated_sequences(trajectory: Trajectory, target: int, free: FreeFlights) -> list[Vertices]:
    """The sequences that throws drawn from the fit make before the first frame of the target flight, most frequent first.

    Each is counted without its last impacts too, at half the weight: a draw may be early.
    """
    until_s = float(free.observations.time_s[free.observations.flight == target][0])
    spread = trajectory.covariance_root * np.sqrt(max(1.0, free.variance))
    rng = np.random.default_rng(0)
    counts: Counter[Vertices] = Counter()
    done = len(trajectory.vertices)
    for k in range(_DRAWS):
        x = spread @ rng.standard_normal(len(spread)) if k else np.zeros(len(spread))
        sequence = own_sequence(trajectory.physics.moved(x[12:]), perturbed(trajectory.state, x[:12]), until_s)
        if sequence[:done] == trajectory.vertices:
            for end in range(done + 1, len(sequence) + 1):
                counts[sequence[done:end]] += 1 if end < len(sequence) else 2
    return [sequence for sequence, _ in counts.most_common(_MAX_SIMULATED)]


def own_sequence(physics: Physics, start: State, until_s: float) -> Vertices:
    """The vertices that touch in a simulation without prescription, until a time on the track's clock or until bouncing
    ends; empty for a start below the table, from which there is no throw."""
    end_s = physics.clock * until_s
    run = physics.run(start, end_s=end_s, impacts=_MAX_IMPACTS, keep=True)
    if run is None:
        return ()
    held = np.flatnonzero(run.vertices < 0)
    return tuple(int(vertex) for vertex in run.vertices[: held[0] if len(held) else None])
