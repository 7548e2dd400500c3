"""A filmed cube with pips, its poses by edges, and the marks learned from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from footage_of_throws import DICE, FPS, Image, Spot, photograph, pips, studio
from numpy.typing import NDArray
from throws import true_throw

from diethrow.model.rotations import quat_from_rotvec, quat_multiply
from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.tracking.flights.flight_chain import VertexImpact
from diethrow.tracking.picture import View
from diethrow.tracking.surface_marks.learning import frames_to_learn_from, learn_marks
from diethrow.tracking.surface_marks.textures import SurfaceMarks
from diethrow.tracking.track import TRACKED, Track

Array = NDArray[np.float64]

CUBE = replace(DICE["cube"], marks="pips")
STUDIO = replace(studio(), noise_grey=3.0, exposure_s=2e-4)
VIEW = STUDIO.view(CUBE)
FRAMES = 90
SIGMA = np.array([1e-5] * 3 + [2e-3] * 3)
"""Noise of the poses from edges, position [m] and rotation [rad]."""
TOWARDS = (np.array([0.0, 0.0, 0.02]) - STUDIO.camera.centre_m) / np.linalg.norm(
    [0.0, 0.0, 0.02] - STUDIO.camera.centre_m
)
COMMON = np.concatenate([2e-3 * TOWARDS + 5e-5 * STUDIO.camera.rotation[0], np.radians([0.3, -0.2, 0.3])])
"""An error common to all poses from edges: 0.5 % of the distance, 0.05 mm across the line of sight, and 0.5 degrees."""


def tossed() -> Flight:
    """A cube that rises and falls within the picture and rotates by half a turn."""
    start = State(
        0.0, np.array([-0.004, 0.0, 0.012]), np.array([0.8, 0.3, 0.1, 0.5]) / np.linalg.norm([0.8, 0.3, 0.1, 0.5]),
        np.array([0.12, 0.0, 0.32]), np.array([36.0, 30.0, -40.0]),
    )  # fmt: skip
    return Flight(start, FRAMES / FPS)


def filmed(spots: tuple[Spot, ...], which: range = range(FRAMES)) -> dict[int, Image]:
    """Frames by number."""
    rng = np.random.default_rng(3)
    return {k: np.rint(photograph(STUDIO, CUBE, tossed().at(k / FPS), rng, spots)) for k in which}


@cache
def marked_film() -> dict[int, Image]:
    return filmed(pips(CUBE))


def edges_track(motion: Flight | Throw, common: Array, frames: int = FRAMES) -> Track:
    """Poses as by edges: the truth, an error common to all frames (6,) or of each (frames, 6), and noise."""
    rng = np.random.default_rng(11)
    times = np.arange(frames) / FPS
    p, q = motion.poses(times)
    error = common + SIGMA * rng.standard_normal((frames, 6))
    covariance = np.tile(np.diag(SIGMA**2), (frames, 1, 1))
    return Track(
        np.arange(frames), times, p - error[:, :3], quat_multiply(quat_from_rotvec(-error[:, 3:]), q), covariance,
        np.full(frames, TRACKED),
    )  # fmt: skip


def moved_flight(flight: Flight, common: Array) -> Flight:
    """The flight through poses with a common error, at their middle."""
    middle = flight.at(0.5 * (flight.start.time_s + flight.end_s))
    start = replace(
        middle,
        position_m=middle.position_m - common[:3],
        quaternion=quat_multiply(quat_from_rotvec(-common[3:]), middle.quaternion),
    )
    return Flight(Flight(start, flight.end_s).at(flight.start.time_s), flight.end_s)


def learned(film: dict[int, Image], common: Array) -> tuple[SurfaceMarks | None, Track, Throw]:
    track = edges_track(tossed(), common)
    throw = Throw((moved_flight(tossed(), common),), ())
    return learned_from(film, track, throw), track, throw


def learned_from(film: dict[int, Image], track: Track, throw: Throw, view: View = VIEW) -> SurfaceMarks | None:
    rows = frames_to_learn_from(track, throw)
    return learn_marks(
        view, ((int(k), film[int(k)]) for k in rows if k in film), track, throw, (), saturation_grey=255.0
    )


def struck(frames_after: int) -> Throw:
    """The same cube, from a frame on which it falls until `frames_after` its impact."""
    return true_throw(CUBE, replace(tossed().at(40 / FPS), time_s=0.0), 0.6, impacts=1, frames_after=frames_after)


@cache
def struck_film() -> list[Image]:
    """Frames until shortly after the impact."""
    throw, rng = struck(5), np.random.default_rng(3)
    times = np.arange(int(throw.flights[-1].end_s * FPS) + 1) / FPS
    states = [throw.flights[throw.flight_at(t)].at(t) for t in times]
    return [np.rint(photograph(STUDIO, CUBE, state, rng, pips(CUBE))) for state in states]


def learned_along(throw: Throw, vertex_impacts: Sequence[VertexImpact | None]) -> SurfaceMarks:
    """Marks of the filmed impact, with its known law, from edges with the common error; the throw may end before the
    film."""
    film = struck_film()
    track = edges_track(throw, COMMON, int(throw.flights[-1].end_s * FPS) + 1)
    displaced = replace(throw, flights=tuple(moved_flight(flight, COMMON) for flight in throw.flights))
    rows = frames_to_learn_from(track, displaced)
    marks = learn_marks(
        VIEW, ((int(k), film[int(k)]) for k in rows), track, displaced, vertex_impacts, saturation_grey=255.0
    )
    assert marks is not None
    return marks


@cache
def learned_marks() -> tuple[SurfaceMarks, Track]:
    marks, track, _ = learned(marked_film(), COMMON)
    assert marks is not None
    return marks, track
