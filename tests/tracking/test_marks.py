"""Laws of marks as features of the pose: what all edges get wrong alike is taken out, and what is left is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, REACH_M, Image, Spot, photograph, pips, studio
from numpy.typing import NDArray

from diethrow.model.motion import Flight, State, Throw
from diethrow.model.rotations import quat_from_matrix, quat_from_rotvec, quat_multiply, rotation_between
from diethrow.tracking.marks import Marks, frames_to_learn_from, learn_marks, refine_by_marks, undistorted_rays
from diethrow.tracking.pose import Pose
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
        np.array([0.12, 0.0, 0.32]), np.array([30.0, 25.0, -34.0]),
    )  # fmt: skip
    return Flight(start, FRAMES / FPS)


def filmed(spots: tuple[Spot, ...], seed: int = 3) -> list[Image]:
    rng = np.random.default_rng(seed)
    return [np.rint(photograph(ROOM, CUBE, tossed().at(k / FPS), rng, spots)) for k in range(FRAMES)]


@cache
def marked_film() -> list[Image]:
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


def learned(film: list[Image], common: Array) -> tuple[Marks | None, Track, Throw]:
    track = edges_track(tossed(), common)
    throw = Throw((moved_flight(tossed(), common),), ())
    rows = frames_to_learn_from(track, throw)
    return learn_marks(VIEW, ((int(k), film[k]) for k in rows), track, throw, saturation_grey=255.0), track, throw


@cache
def learned_marks() -> tuple[Marks, Track]:
    marks, track, _ = learned(marked_film(), COMMON)
    assert marks is not None
    return marks, track


def single_frames(film: list[Image], which: range) -> tuple[Array, Array]:
    """Errors (n, 6), true minus refined, of single frames, and their informations (n, 6, 6)."""
    marks, track = learned_marks()
    errors, informations = [], []
    for k in which:
        edges = Pose(
            track.position_m[k], State(0.0, *np.zeros((1, 3)), track.quaternion[k], *np.zeros((2, 3))).rotation,
            np.linalg.inv(track.covariance[k]), 0.0, 1.0, 100.0, 0.0,
        )  # fmt: skip
        pose = refine_by_marks(VIEW, marks, film[k], edges, marks.flights[0].at(k / FPS))
        true = tossed().at(k / FPS)
        turned = rotation_between(quat_from_matrix(pose.rotation), true.quaternion)
        errors.append(np.concatenate([true.position_m - pose.position_m, turned]))
        informations.append(pose.information)
    return np.array(errors), np.array(informations)


def test_rays_go_back_through_the_lens_to_their_pixels() -> None:
    rays = undistorted_rays(ROOM.camera).astype(float)
    points = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=2)
    world = (0.3 * points - ROOM.camera.translation_m) @ ROOM.camera.rotation
    v, u = np.mgrid[0 : rays.shape[0], 0 : rays.shape[1]]
    # Rays are kept in single precision: 6e-8 of a slope of 0.1, times the focal length.
    assert np.abs(ROOM.camera.project(world) - np.stack([u, v], 2)).max() < 1e-3


def test_an_error_that_all_edges_share_is_taken_out() -> None:
    marks, _ = learned_marks()
    times = np.arange(FRAMES) / FPS
    p, q = tossed().poses(times)
    found_p, found_q = marks.flights[0].poses(times)
    turned = np.degrees(np.linalg.norm(rotation_between(found_q, q), axis=1))
    off = (found_p - p) @ ROOM.camera.rotation.T
    # The edges are wrong by 0.47 degrees, 0.05 mm and 2 mm. Ninety frames of pips 8 px across hold 0.03 degrees, 2 µm
    # sideways, and 0.1 mm of distance (3e-4 of it, as a share of the die's size 0.02 px).
    assert np.median(turned) < 0.08
    assert np.median(np.hypot(off[:, 0], off[:, 1])) < 8e-6
    assert np.median(np.abs(off[:, 2])) < 3e-4


def test_the_flight_knows_how_uncertain_the_places_of_its_marks_leave_it() -> None:
    marks, _ = learned_marks()
    flight = marks.flights[0]
    true = tossed().at(flight.start.time_s)
    miss = np.concatenate(
        [true.position_m - flight.start.position_m, rotation_between(flight.start.quaternion, true.quaternion)]
    )
    C = flight.covariance
    assert C is not None
    # One draw of chi-square with six degrees of freedom: 22.5 is exceeded once in a thousand.
    assert miss @ np.linalg.solve(C[:6, :6], miss) < 22.5
    # What all frames share cannot be more than the whole.
    assert np.linalg.eigvalsh(C - marks.shared[0]).min() > -1e-9 * np.linalg.eigvalsh(C).max()
    assert np.trace(marks.shared[0][:3, :3]) > 0.05 * np.trace(C[:3, :3])


def test_single_frames_lie_within_their_sigmas() -> None:
    errors, informations = single_frames(marked_film(), range(0, FRAMES, 2))
    nees = np.einsum("ni,nij,nj->n", errors, informations, errors)
    # Median of chi-square with six: 5.35, scattering by 0.6 over 45 frames; learned textures have noise of their own.
    assert 3.0 < np.median(nees) < 9.0
    assert np.degrees(np.median(np.linalg.norm(errors[:, 3:], axis=1))) < 0.15


def test_the_lens_blur_is_seen_on_the_marks() -> None:
    # Half a texel of the first poses' scatter and the cubic interpolation may add a tenth.
    assert learned_marks()[0].blur_px == pytest.approx(ROOM.blur_px, abs=0.12)


def test_a_rod_over_half_of_the_die_does_not_pull_it() -> None:
    film = []
    which = range(10, FRAMES - 10, 4)
    for k in range(FRAMES):
        u, _ = ROOM.camera.project(tossed().at(k / FPS).position_m)
        hidden = marked_film()[k].copy()
        hidden[:, int(u) : int(u) + 12] = 40.0
        film.append(hidden)
    errors, informations = single_frames(film, which)
    nees = np.einsum("ni,nij,nj->n", errors, informations, errors)
    # Fewer pixels make wider sigmas; pixels at the rod's border that escape the weights may add a little.
    assert np.median(nees) < 12.0
    across = np.linalg.norm(errors[:, :3] @ ROOM.camera.rotation[:2].T, axis=1)
    assert np.median(across) < 2e-5


def test_plain_faces_teach_nothing() -> None:
    assert learned(filmed(()), np.zeros(6))[0] is None


def test_without_a_marked_face_in_view_the_edges_stand_with_wider_sigmas() -> None:
    marks, track = learned_marks()
    pose = Pose(track.position_m[5], tossed().at(5 / FPS).rotation, np.linalg.inv(track.covariance[5]), 0.0, 1.0, 9.0, 0.0)
    back = refine_by_marks(VIEW, replace(marks, noise_grey=np.zeros(6)), marked_film()[5], pose)
    assert back.position_m == pytest.approx(pose.position_m)
    assert np.linalg.eigvalsh(pose.information - back.information).min() > -1e-6 * np.linalg.eigvalsh(pose.information).max()


def test_frames_at_a_bounce_teach_nothing() -> None:
    track = edges_track(tossed(), np.zeros(6))
    flight = tossed()
    from replay_records import some_impact

    throw = Throw((flight, flight), (some_impact(30.4 / FPS),))
    rows = frames_to_learn_from(track, throw)
    assert not {30, 31} & set(rows.tolist())
    assert {29, 32} <= set(rows.tolist())


def test_the_die_is_as_large_as_the_others() -> None:
    assert CUBE.solid.circumradius == pytest.approx(REACH_M)
