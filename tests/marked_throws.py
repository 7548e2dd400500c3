"""A cube with pips that was filmed, and what edges and marks say of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from footage_of_throws import DICE, FPS, Image, Spot, photograph, pips, studio
from numpy.typing import NDArray

from diethrow.model.motion import Flight, State, Throw
from diethrow.model.rotations import quat_from_rotvec, quat_multiply
from diethrow.tracking.marks import frames_to_learn_from, learn_marks
from diethrow.tracking.marks_textures import Marks
from diethrow.tracking.track import TRACKED, Track

Array = NDArray[np.float64]

CUBE = replace(DICE["cube"], marks="pips")
ROOM = replace(studio(), noise_grey=3.0, exposure_s=2e-4)
VIEW = ROOM.view(CUBE)
FRAMES = 90
SIGMA = np.array([1e-5] * 3 + [2e-3] * 3)
"""Noise of the edges' poses here, position [m] and rotation [rad]."""
TOWARDS = (np.array([0.0, 0.0, 0.02]) - ROOM.camera.centre_m) / np.linalg.norm([0.0, 0.0, 0.02] - ROOM.camera.centre_m)
COMMON = np.concatenate([2e-3 * TOWARDS + 5e-5 * ROOM.camera.rotation[0], np.radians([0.3, -0.2, 0.3])])
"""An error that all poses from edges share: half a per cent of the distance, 0.05 mm sideways, and half a degree."""


def tossed() -> Flight:
    """A cube that rises and falls in the picture and turns by half a turn."""
    start = State(
        0.0, np.array([-0.004, 0.0, 0.012]), np.array([0.8, 0.3, 0.1, 0.5]) / np.linalg.norm([0.8, 0.3, 0.1, 0.5]),
        np.array([0.12, 0.0, 0.32]), np.array([36.0, 30.0, -40.0]),
    )  # fmt: skip
    return Flight(start, FRAMES / FPS)


def filmed(spots: tuple[Spot, ...], which: range = range(FRAMES)) -> dict[int, Image]:
    """Frames by number."""
    rng = np.random.default_rng(3)
    return {k: np.rint(photograph(ROOM, CUBE, tossed().at(k / FPS), rng, spots)) for k in which}


@cache
def marked_film() -> dict[int, Image]:
    return filmed(pips(CUBE))


def edges_track(flight: Flight, common: Array) -> Track:
    """Poses as edges would give them: the truth, a common error, and noise."""
    rng = np.random.default_rng(11)
    times = np.arange(FRAMES) / FPS
    p, q = flight.poses(times)
    error = common + SIGMA * rng.standard_normal((FRAMES, 6))
    covariance = np.tile(np.diag(SIGMA**2), (FRAMES, 1, 1))
    return Track(
        np.arange(FRAMES), times, p - error[:, :3], quat_multiply(quat_from_rotvec(-error[:, 3:]), q), covariance,
        np.full(FRAMES, TRACKED),
    )  # fmt: skip


def moved_flight(flight: Flight, common: Array) -> Flight:
    """The flight that runs through poses with a common error, at their middle."""
    middle = flight.at(0.5 * flight.end_s)
    start = replace(
        middle,
        position_m=middle.position_m - common[:3],
        quaternion=quat_multiply(quat_from_rotvec(-common[3:]), middle.quaternion),
    )
    return Flight(start, flight.end_s)


def learned(film: dict[int, Image], common: Array) -> tuple[Marks | None, Track, Throw]:
    track = edges_track(tossed(), common)
    throw = Throw((moved_flight(tossed(), common),), ())
    rows = frames_to_learn_from(track, throw)
    return (
        learn_marks(VIEW, ((int(k), film[int(k)]) for k in rows if k in film), track, throw, saturation_grey=255.0),
        track,
        throw,
    )


@cache
def learned_marks() -> tuple[Marks, Track]:
    marks, track, _ = learned(marked_film(), COMMON)
    assert marks is not None
    return marks, track
