"""Laws of segmentation: where a contact may lie does not hang on the shape of the die."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from throws import FPS, random_release, seen, true_throw

from diethrow.model.die.die import make_die
from diethrow.model.die.solid import SHAPES
from diethrow.tracking.throw.measurement import measure_throw

CIRCUMRADIUS_M = 0.01
SEEN_ABOVE = 0.5
"""Height above its own, in circumradii, at which a die is seen: half a per cent of a metre that it is away."""
FRAMES_BEHIND = 10
THROWS = 3


@pytest.mark.parametrize("shape", SHAPES)
def test_a_die_that_is_seen_too_high_bounces_all_the_same(shape: str) -> None:
    """The edge of a dodecahedron is a third of its diameter, that of a tetrahedron four fifths."""
    edge_m, seed, found = CIRCUMRADIUS_M / make_die(shape, 1.0, 1.0).solid.circumradius, 0, 0
    die = make_die(shape, edge_m, 0.003)
    while found < THROWS:
        rng = np.random.default_rng(seed)
        throw = true_throw(die, random_release(die, rng), 0.6, impacts=1, frames_after=25)
        track, seed = seen(throw, rng), seed + 1
        if (throw.flights[1].end_s - throw.impacts[0].time_s) * FPS < FRAMES_BEHIND:
            continue
        above_m = np.array([0.0, 0.0, SEEN_ABOVE * CIRCUMRADIUS_M])
        measured = measure_throw(replace(track, position_m=track.position_m + above_m), die)
        assert [impact.vertices for impact in measured.impacts] == [throw.impacts[0].vertices]
        assert measured.impacts[0].time_s == pytest.approx(throw.impacts[0].time_s, abs=1e-4)
        found += 1
