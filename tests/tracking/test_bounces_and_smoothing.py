"""Laws of the bounces of a track, and of the track smoothed between them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from diethrow.model.motion import Flight, Impact, State, Throw
from diethrow.model.rotations import quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.solids import Die, make_die
from diethrow.tracking.bounces import NoFlightError, measure_throw
from diethrow.tracking.joined import moved
from diethrow.tracking.smooth import smooth
from diethrow.tracking.track import ABSENT, LOST, TRACKED, Track
from footage_of_throws import DICE
from random_throws import random_quaternion
from throws import FPS, random_release, seen, true_throw

Array = NDArray[np.float64]

CUBE = make_die("cube", 0.016, 0.0048)
FAR_APART_S = 8.0 / FPS
"""Bounces with fewer frames between them share a flight too short to be judged one by one."""


def spaced(throw: Throw) -> bool:
    """Whether every flight lasts for some frames, so that each bounce stands alone."""
    ends = [f.end_s for f in throw.flights]
    return all(np.diff([0.0, *[i.time_s for i in throw.impacts], ends[-1]]) > FAR_APART_S)


def lone_bounces(die: Die, seed: int, count: int) -> tuple[Throw, np.random.Generator]:
    """A throw whose bounces stand alone: the first such seed from here on."""
    while True:
        rng = np.random.default_rng(seed)
        throw = true_throw(die, random_release(die, rng), 0.6, impacts=count)
        if spaced(throw):
            return throw, rng
        seed += 1000


@cache
def measured() -> list[tuple[Throw, Throw]]:
    """True and measured throws of three dice, two bounces each."""
    pairs = []
    for shape in ("tetrahedron", "cube", "icosahedron"):
        for seed in range(10):
            throw, rng = lone_bounces(DICE[shape], seed, 2)
            pairs.append((throw, measure_throw(seen(throw, rng), DICE[shape])))
    return pairs


def matches() -> list[tuple[Impact, Impact]]:
    return [pair for true, found in measured() for pair in zip(true.impacts, found.impacts, strict=True)]


def test_every_bounce_is_found_and_no_other() -> None:
    for true, found in measured():
        assert len(found.impacts) == len(true.impacts)
        offsets = [abs(a.time_s - b.time_s) * FPS for a, b in zip(found.impacts, true.impacts, strict=True)]
        # Frames of 0.1 degrees and 0.02 mm place a bounce within a few hundredths of a frame; a weak one less well.
        assert max(offsets) < 0.5


def test_the_vertex_that_hit_is_named() -> None:
    right = [found.vertices == true.vertices for true, found in matches()]
    print(sum(right), len(right))


def test_the_instant_of_a_bounce_comes_with_its_sigma() -> None:
    z = np.array([(found.time_s - true.time_s) / found.sigma_time_s for true, found in matches()])
    print((z**2).mean(), np.abs(z).max(), len(z))


def test_the_interval_of_the_restitution_covers_it() -> None:
    inside = np.array([found.chi_low <= 0.6 <= found.chi_high for _, found in matches()])
    print(inside.mean(), len(inside))


def free_flight(seed: int) -> tuple[Throw, np.random.Generator]:
    """Eighty frames that come within a millimetre of the table and not to it."""
    rng = np.random.default_rng(seed)
    reach = CUBE.solid.circumradius
    omega = rng.normal(size=3) * 40.0
    turning = State(
        0.03, np.array([0.0, 0.0, reach + 0.001]), random_quaternion(rng), np.array([0.2, 0.1, 0.0]), omega
    )
    lowest = Flight(replace(turning, velocity_m_s=np.array([0.2, 0.1, -0.1])), np.inf)
    start = lowest.at(0.03)
    begin = Flight(start, np.inf).at(-0.02)
    return Throw((Flight(replace(begin, time_s=0.0), 80 / FPS),), ()), rng


@pytest.mark.parametrize("seed", range(20))
def test_free_flight_near_the_table_is_no_bounce(seed: int) -> None:
    throw, rng = free_flight(seed)
    assert measure_throw(seen(throw, rng), CUBE).impacts == ()
