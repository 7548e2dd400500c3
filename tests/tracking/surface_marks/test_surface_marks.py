"""Laws of surface marks as features of the pose: they remove the common error of edges, and state the error that
remains."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import FPS, Image
from marked_throws import (
    COMMON,
    CUBE,
    FRAMES,
    SIGMA,
    STUDIO,
    VIEW,
    edges_track,
    filmed,
    learned,
    learned_along,
    learned_from,
    learned_marks,
    marked_film,
    struck,
    tossed,
)
from numpy.typing import NDArray
from throws import impact_at

from diethrow.model.compiled import compiled
from diethrow.model.rotations import angle_between, matrix_from_quat, quat_from_matrix, rotation_between
from diethrow.model.throw.motion import Impact, Throw
from diethrow.tracking.surface_marks.learning import frames_to_learn_from, labels_by_marks
from diethrow.tracking.surface_marks.pose_refinement import FramePoses, FrameRefinement
from diethrow.tracking.surface_marks.texture_blur import blur_texture
from diethrow.tracking.surface_marks.textures import SurfaceMarks, pixel_rays

Array = NDArray[np.float64]


@compiled
def blurred(surface: Array, blur: Array, scratch: Array) -> int:
    """Python cannot call a kernel that only kernels call."""
    return int(blur_texture(surface, blur, scratch))


def refined(marks: SurfaceMarks, film: dict[int, Image], which: range) -> tuple[FramePoses, FramePoses, Array]:
    """Poses (n) of some frames by edges, by marks and edges, and their shared covariance (n, 6, 6)."""
    track, rows = learned_marks()[1], np.array(which)
    edges = FramePoses(
        track.position_m[rows], matrix_from_quat(track.quaternion[rows]), np.linalg.inv(track.covariance[rows]),
        np.zeros((len(rows), 6, 1)),
    )  # fmt: skip
    frames = np.array([film[k] for k in which])[:, None]
    refinement = FrameRefinement(VIEW, marks, edges, Throw(marks.flights, ()), rows / FPS)
    with ThreadPoolExecutor(2) as pool:
        for job in refinement.refine(frames, np.arange(len(rows)), slice(0, len(rows)), pool):
            job.result()
    return edges, refinement.poses(), refinement.shared_covariance


def single_frames(film: dict[int, Image], which: range) -> tuple[Array, Array]:
    """Errors (n, 6), true minus refined, of single frames, and their squares in standard errors (n,), own and
    shared."""
    _, poses, shared = refined(learned_marks()[0], film, which)
    positions, quaternions = tossed().poses(np.array(which) / FPS)
    turned = rotation_between(quat_from_matrix(poses.rotation), quaternions)
    errors = np.concatenate([positions - poses.position_m, turned], axis=1)
    C = np.linalg.inv(poses.information) + shared
    return errors, np.einsum("ni,nij,nj->n", errors, np.linalg.inv(C), errors)


def test_rays_project_onto_their_pixels() -> None:
    rays = pixel_rays(STUDIO.camera).astype(float)
    points = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=2)
    world = (0.3 * points - STUDIO.camera.translation_m) @ STUDIO.camera.rotation
    v, u = np.mgrid[0 : rays.shape[0], 0 : rays.shape[1]]
    # Rays are in single precision: 6e-8 of a slope of 0.1, times the focal length.
    assert np.abs(STUDIO.camera.project(world) - np.stack([u, v], 2)).max() < 1e-3


def test_marks_remove_an_error_that_all_edges_share() -> None:
    marks, _ = learned_marks()
    times = np.arange(FRAMES) / FPS
    p, q = tossed().poses(times)
    found_p, found_q = marks.flights[0].poses(times)
    turned = np.degrees(angle_between(found_q, q))
    off = (found_p - p) @ STUDIO.camera.rotation.T
    # The edges are wrong by 0.47 degrees, 0.05 mm and 2 mm. Ninety frames of pips 8 px across determine 0.03 degrees,
    # 2 µm sideways, and 0.1 mm of distance (3e-4 of it, as a share of the die's size 0.02 px).
    assert np.median(turned) < 0.08
    assert np.median(np.hypot(off[:, 0], off[:, 1])) < 8e-6
    assert np.median(np.abs(off[:, 2])) < 3e-4


def test_the_covariance_of_a_flight_includes_the_placement_of_the_marks() -> None:
    marks, _ = learned_marks()
    flight = marks.flights[0]
    true = tossed().at(flight.start.time_s)
    error = np.concatenate(
        [true.position_m - flight.start.position_m, rotation_between(flight.start.quaternion, true.quaternion)]
    )
    C = flight.covariance
    assert C is not None
    # One draw of chi-square with six degrees of freedom: 22.5 is exceeded once in a thousand.
    assert error @ np.linalg.solve(C[:6, :6], error) < 22.5
    # The shared part cannot exceed the whole.
    assert np.linalg.eigvalsh(C - marks.shared_covariance[0]).min() > -1e-9 * np.linalg.eigvalsh(C).max()
    assert np.trace(marks.shared_covariance[0][:3, :3]) > 0.05 * np.trace(C[:3, :3])


@pytest.mark.parametrize("frames_after", [5, 2], ids=["both flights adjusted", "one flight adjusted"])
def test_an_impact_on_the_table_determines_the_distance(frames_after: int) -> None:
    throw = struck(frames_after)
    vertex, t = throw.impacts[0].vertices[0], throw.impacts[0].time_s
    strike = impact_at(CUBE, vertex)
    # The time of the impact is as accurate as by edges. Frames beside it are not used, which leaves the shorter
    # flight one.
    impact = replace(throw.impacts[0], sigma_time_s=0.01 / FPS)
    throw = replace(throw, impacts=(impact,))
    depth, sigma = [], []
    for strikes in ((None,), (strike,)):
        flight, true = learned_along(throw, strikes).flights[0], throw.flights[0].start
        error = np.concatenate(
            [true.position_m - flight.start.position_m, rotation_between(flight.start.quaternion, true.quaternion)]
        )
        assert flight.covariance is not None
        # One draw of chi-square with six degrees of freedom.
        assert error @ np.linalg.solve(flight.covariance[:6, :6], error) < 22.5
        depth.append(abs(float(error[:3] @ STUDIO.camera.rotation[2])))
        sigma.append(float(np.sqrt(flight.covariance[2, 2])))
    assert depth[1] < 0.5 * depth[0]
    assert sigma[1] < 0.5 * sigma[0]
    # A table known to 0.03 mm and a contact to 0.02 mm: three standard deviations of both.
    end = flight.at(t)
    assert abs(float((end.position_m + end.rotation @ strike.point_m)[2])) < 1.1e-4


def test_the_common_error_of_edges_is_distinguished_from_that_of_single_frames() -> None:
    unbiased, _, _ = learned(marked_film(), np.zeros(6))
    assert unbiased is not None
    # The edges of both have the same noise of single frames, 2 mrad, which is 0.03 mm at the die's border. What
    # COMMON adds is 0.1 mm there by its turn, and 0.05 mm by its shift and by its distance.
    assert unbiased.contour_m < 1e-5
    assert 3e-5 < learned_marks()[0].contour_m < 1.5e-4


def test_errors_of_edges_that_consecutive_frames_share_count_as_common() -> None:
    slow = 3.0 * SIGMA * np.repeat(np.random.default_rng(12).standard_normal((8, 6)), 12, axis=0)[:FRAMES]
    track = edges_track(tossed(), slow)
    # The stated covariance covers both: three standard deviations of what each dozen shares, and one of a frame's own.
    track = replace(track, covariance=10.0 * track.covariance)
    marks = learned_from(marked_film(), track, Throw((tossed(),), ()))
    assert marks is not None
    # 0.03 mm sideways, and 6 mrad, which is 0.08 mm at the die's border.
    assert 2e-5 < marks.contour_m < 1.5e-4


def test_errors_of_single_frames_match_their_covariance() -> None:
    errors, squares = single_frames(marked_film(), range(FRAMES))
    # The median of chi-square with six is 5.35 ± 0.6 over 90 frames; their shared part is drawn only once.
    assert 3.0 < np.median(squares) < 9.0
    assert np.degrees(np.median(np.linalg.norm(errors[:, 3:], axis=1))) < 0.15


@pytest.mark.parametrize("error_px", [-0.1, 0.1])
def test_an_error_of_the_lens_blur_hardly_moves_the_flight(error_px: float) -> None:
    track = edges_track(tossed(), np.zeros(6))
    throw, times = Throw((tossed(),), ()), np.arange(FRAMES) / FPS
    poses = []
    for error in (0.0, error_px):
        marks = learned_from(marked_film(), track, throw, replace(VIEW, blur_px=STUDIO.blur_px + error))
        assert marks is not None
        poses.append(marks.flights[0].poses(times))
    (p, q), (moved_p, moved_q) = poses
    off = np.abs((moved_p - p) @ STUDIO.camera.rotation.T)
    # A round mark seen aslant looks longer by the blur that is missing. The flight stays within about its standard errors,
    # 0.03 degrees, 2 µm sideways and 0.1 mm of distance; an error of 0.25 px moves it by 0.1 degrees.
    assert np.degrees(np.median(angle_between(q, moved_q))) < 0.04
    assert np.median(off[:, :2]) < 2e-6
    assert np.median(off[:, 2]) < 1e-4


def test_a_rod_in_front_of_half_the_die_does_not_bias_the_pose() -> None:
    film = {}
    which = range(10, FRAMES - 10, 5)
    for k in which:
        u, _ = STUDIO.camera.project(tossed().at(k / FPS).position_m)
        hidden = marked_film()[k].copy()
        hidden[:, int(u) : int(u) + 12] = 40.0
        film[k] = hidden
    errors, squares = single_frames(film, which)
    # Fewer pixels give larger standard errors; pixels at the rod's border that keep a weight may add a little.
    assert np.median(squares) < 12.0
    across = np.linalg.norm(errors[:, :3] @ STUDIO.camera.rotation[:2].T, axis=1)
    assert np.median(across) < 2e-5


def test_plain_faces_have_no_marks() -> None:
    # Noise is not taken for a mark.
    film = filmed((), range(0, FRAMES, 4))
    assert learned(film, np.zeros(6))[0] is None


def test_a_pattern_that_stays_in_the_picture_is_not_taken_for_a_mark() -> None:
    # A sensor's pattern is the same on even and odd frames while the die hardly moves.
    pattern = 4.0 * np.random.default_rng(5).standard_normal(marked_film()[0].shape)
    film = {k: np.rint(image + pattern) for k, image in filmed(()).items()}
    assert learned(film, np.zeros(6))[0] is None


def test_without_a_marked_face_in_view_the_pose_by_edges_stays_with_less_information() -> None:
    marks = replace(learned_marks()[0], noise_grey=np.zeros(6))
    edges, poses, _ = refined(marks, marked_film(), range(5, 6))
    np.testing.assert_allclose(poses.position_m, edges.position_m, rtol=1e-12)
    lost_information = np.linalg.eigvalsh(edges.information[0] - poses.information[0])
    assert lost_information.min() > -1e-6 * np.linalg.eigvalsh(edges.information[0]).max()


def test_frames_at_an_impact_are_not_learned_from() -> None:
    nan = np.nan
    bounce = Impact(30.4 / FPS, "vertex", (0,), np.zeros(2), np.zeros(3), nan, nan, nan, nan, 1, 1)
    rows = frames_to_learn_from(edges_track(tossed(), np.zeros(6)), Throw((tossed(), tossed()), (bounce,)))
    assert not {30, 31} & set(rows.tolist())
    assert {29, 32} <= set(rows.tolist())


@pytest.mark.parametrize(
    "blur", [(0.3, 0.1, 0.2), (1.6, -0.4, 0.5), (7.0, 2.0, 3.0), (40.0, 0.0, 0.1), (-0.2, 0.05, -0.1)]
)
def test_blur_on_the_grid_adds_its_covariance_to_any_cubic(blur: tuple[float, float, float]) -> None:
    """The mean of a cubic over displacements of a covariance is the cubic plus half of the covariance times its
    second derivatives; a negative blur subtracts as much."""
    a, b, c, d = 1.3, -0.7, 0.4, 0.9
    y, x = np.mgrid[-60:61, -60:61] / 10.0
    xx, xy, yy = (0.01 * v for v in blur)
    cubic = a * x**3 + b * x * x * y + c * x * y * y + d * y * y
    wanted = cubic + 0.5 * (xx * (6 * a * x + 2 * b * y) + 2 * xy * (2 * b * x + 2 * c * y) + yy * (2 * c * x + 2 * d))
    scratch = np.full((2, *cubic.shape), np.nan)
    found = scratch[blurred(cubic, np.array(blur), scratch)]
    assert np.isfinite(found).all()
    # The border stays unchanged, which affects one more row with each pass.
    np.testing.assert_allclose(found[50:71, 50:71], wanted[50:71, 50:71], atol=1e-9)


def test_no_blur_leaves_a_texture_as_it_is() -> None:
    # A face that is learned on one frame has exactly the blur of that frame; the difference was divided by its size.
    texture = np.random.default_rng(1).normal(size=(9, 9))
    scratch = np.full((2, 9, 9), np.nan)
    assert np.array_equal(scratch[blurred(texture, np.zeros(3), scratch)], texture)


GROUPS = (np.arange(FRAMES) >= FRAMES // 2).astype(np.int64)
"""Two halves of the film, within each of which one labelling holds."""


def labels_of_second_half(film: dict[int, Image], symmetry: Array) -> Array:
    """The labels found of the second half, whose faces were labelled anew by a symmetry of the die."""
    track = edges_track(tossed(), COMMON)
    rotation = matrix_from_quat(track.quaternion)
    rotation[GROUPS == 1] = rotation[GROUPS == 1] @ symmetry
    track = replace(track, quaternion=quat_from_matrix(rotation))
    images = ((k, film[k]) for k in range(0, FRAMES, 2))
    first, second = labels_by_marks(VIEW, images, track, tossed().rates(np.arange(FRAMES) / FPS), GROUPS)
    assert np.array_equal(first, np.eye(3))
    return second


@pytest.mark.parametrize("k", [0, 5, 11, 17, 23])
def test_marks_tell_how_a_die_was_labelled_anew(k: int) -> None:
    symmetry = VIEW.symmetries[k]
    assert symmetry @ labels_of_second_half(marked_film(), symmetry) == pytest.approx(np.eye(3))


def test_a_plain_die_keeps_its_labels() -> None:
    assert np.array_equal(labels_of_second_half(filmed(()), VIEW.symmetries[5]), np.eye(3))
