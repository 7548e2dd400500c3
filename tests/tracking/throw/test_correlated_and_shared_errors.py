"""Laws of the error model: autocorrelated errors of frames, and errors that all frames of a clip share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import studio
from numpy.typing import NDArray
from throws import FPS, blurred_in_time, random_release, seen, true_throw, weighted_poses

from diethrow.model.die.die import make_die
from diethrow.model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.tracking.check.gravity import fall_notices, measure_fall
from diethrow.tracking.flights.error_model import estimate_error_model
from diethrow.tracking.flights.single_flights import (
    ErrorModel,
    chain_residuals,
    fit_flight,
    flight_residuals,
    frame_information,
    gradient_covariances,
    normal_equations,
    packed,
    perturbed,
)
from diethrow.tracking.throw.measurement import measure, with_calibrated_covariance
from diethrow.tracking.throw.shared_bias import (
    CONTOUR_SIGMA_PX,
    placement_covariances,
    shared_bias_jacobian,
    shared_bias_sigma,
)
from diethrow.tracking.throw.smoothing import smooth
from diethrow.tracking.track import LOST, Track

Array = NDArray[np.float64]

CUBE = make_die("cube", 0.016, 0.0048)
ROUND = make_die("cube", 0.016, 0.0048, corner_radius_m=0.0006)


def one_flight(rng: np.random.Generator, frames: int = 120) -> Throw:
    start = State(
        0.0, np.array([0.0, 0.0, 0.2]), np.array([1.0, 0, 0, 0]), rng.normal(size=3), 20.0 * rng.normal(size=3)
    )
    return Throw((Flight(start, frames / FPS),), ())


def with_slow_errors(rng: np.random.Generator, variance_ratio: float, frames: float, flight_frames: int = 120) -> Track:
    """A flight whose errors are white as stated, plus a slow part of `variance_ratio` times that variance."""
    throw = one_flight(rng, flight_frames)
    track = seen(throw, rng)
    slow = blurred_in_time(track, throw, rng, frames)
    p, q = throw.poses(track.time_s)
    size = np.sqrt(variance_ratio)
    rotated = quat_multiply(quat_from_rotvec(size * rotation_between(q, slow.quaternion)), track.quaternion)
    return replace(track, position_m=track.position_m + size * (slow.position_m - p), quaternion=rotated)


def error_model_of(track: Track) -> ErrorModel:
    observations = weighted_poses(track)
    state, _, _ = fit_flight(observations)
    return estimate_error_model(observations, [slice(0, len(track))], [state], np.zeros(0), np.ones(len(track)))


@pytest.mark.parametrize("stated", [0.5, 1.0, 3.0])
def test_independent_errors_are_estimated_as_such_at_their_true_scale(stated: float) -> None:
    rng = np.random.default_rng(3)
    found = error_model_of(seen(one_flight(rng), rng, stated=stated))
    # 720 numbers determine a scale to 3 %; the prior of one frame adds up to 9/120 to the variance, or as much in slow errors.
    assert np.sqrt(found.variance).mean() == pytest.approx(1.0 / stated, rel=0.2)
    assert (found.long_run_variance(1.0 / FPS) / found.variance).max() < 3.0


@pytest.mark.parametrize(
    ("variance_ratio", "frames_correlated", "frames", "accuracy"),
    [
        pytest.param(3.0, 6.0, 120, 0.3, id="usual film"),
        pytest.param(0.05, 500.0, 20_000, 0.1, id="fast film"),
        pytest.param(0.01, 3000.0, 60_000, 0.1, id="faster film"),
    ],
)
def test_slow_errors_are_distinguished_from_white_ones(
    variance_ratio: float, frames_correlated: float, frames: int, accuracy: float
) -> None:
    ratios, sizes = [], []
    for seed in range(6):
        found = error_model_of(with_slow_errors(np.random.default_rng(seed), variance_ratio, frames_correlated, frames))
        sizes.append(found.variance.mean())
        ratios.append(found.long_run_variance(1.0 / FPS).mean())
    # 1 + a, and 1 + a (1 + φ)/(1 - φ) ≈ 1 + 2 a T with φ = exp(-1/T). A flight of twenty to forty correlation times
    # determines its spectrum near zero to a factor of two.
    long_run = 1.0 + 2.0 * variance_ratio * frames_correlated
    assert np.mean(sizes) == pytest.approx(1.0 + variance_ratio, rel=accuracy)
    assert 0.5 * long_run < np.median(ratios) < 2.0 * long_run


def test_a_flight_of_few_frames_leaves_errors_as_stated() -> None:
    rng = np.random.default_rng(1)
    found = error_model_of(seen(one_flight(rng, frames=6), rng, stated=0.1))
    np.testing.assert_array_equal(found.scale, 1.0)
    np.testing.assert_array_equal(found.variance_ratio, 0.0)


def test_the_gradient_covariance_for_white_errors_is_the_normal_matrix() -> None:
    rng = np.random.default_rng(5)
    observations = weighted_poses(seen(one_flight(rng), rng))
    state, _, _ = fit_flight(observations)
    ones, share = np.ones(len(observations)), np.full(6, 0.25)
    cuts, states = np.array([0, len(observations)]), packed(state)[None]
    residuals = chain_residuals(observations, cuts, states, np.zeros(0))
    normal, _ = normal_equations(
        observations, cuts, states, residuals, ones, frame_information(observations, share), 12
    )
    # Weighted by the inverse variance, Xᵀ V X is XᵀX: an identity up to rounding.
    covariances = gradient_covariances(observations, cuts, states, ones, share, ErrorModel.white(2.0), 12)
    unit = 1.0 / np.sqrt(np.diag(normal[0]))
    np.testing.assert_allclose(covariances[0] * np.outer(unit, unit), normal[0] * np.outer(unit, unit), atol=1e-12)


def test_the_gradient_covariance_for_slow_errors_is_that_of_the_full_covariance() -> None:
    rng = np.random.default_rng(6)
    observations = weighted_poses(seen(one_flight(rng, 40), rng)).rows(np.delete(np.arange(40), [7, 8, 21]))
    state, _, _ = fit_flight(observations)
    n = len(observations)
    errors = ErrorModel(np.linspace(0.5, 1.5, 6), np.linspace(0.0, 5.0, 6), np.linspace(1.0, 9.0, 6) / FPS)
    steps = np.concatenate([1e-7 * np.ones(3), 1e-6 * np.ones(3), 1e-5 * np.ones(3), 1e-4 * np.ones(3)])
    X = np.empty((n, 6, 12))
    for a, step in enumerate(np.diag(steps)):
        ahead, behind = (flight_residuals(observations, perturbed(state, sign * step)) for sign in (1.0, -1.0))
        X[:, :, a] = (behind - ahead) / (2.0 * steps[a])
    apart = np.abs(observations.time_s[:, None] - observations.time_s)
    wanted = np.zeros((12, 12))
    for i in range(6):
        V = errors.scale[i] ** 2 * (
            np.eye(n) + errors.variance_ratio[i] * np.exp(-apart / errors.correlation_time_s[i])
        )
        wanted += X[:, i].T @ V @ X[:, i]
    cuts, states = np.array([0, n]), packed(state)[None]
    found = gradient_covariances(observations, cuts, states, np.ones(n), np.ones(6), errors, 12)[0]
    unit = 1.0 / np.sqrt(np.diag(wanted))
    # Central differences of noisy residuals: the derivative is that at the observed pose, off by its residual of 0.1 degrees.
    np.testing.assert_allclose(found * np.outer(unit, unit), wanted * np.outer(unit, unit), atol=0.02)


def lone(seed: int) -> tuple[Throw, np.random.Generator]:
    while True:
        rng = np.random.default_rng(seed)
        throw = true_throw(CUBE, random_release(CUBE, rng), 0.6, impacts=2, frames_after=100)
        ends = [0.0, *(impact.time_s for impact in throw.impacts), throw.flights[-1].end_s]
        if min(np.diff(ends)) > 8.0 / FPS:
            return throw, rng
        seed += 1000


def nees(track: Track, throw: Throw) -> Array:
    p, q = throw.poses(track.time_s[track.tracked])
    use = track.tracked
    errors = np.concatenate([p - track.position_m[use], rotation_between(track.quaternion[use], q)], axis=1)
    return np.array([e @ np.linalg.solve(C, e) for e, C in zip(errors, track.covariance[use], strict=True)])


def over_seeds(frames: float | None, count: int = 10) -> tuple[Array, Array]:
    """NEES of calibrated frames and of the smoothed track, for errors correlated over `frames` that are stated half as large."""
    single, smoothed = [], []
    for seed in range(count):
        throw, rng = lone(seed)
        track = seen(throw, rng)
        if frames is not None:
            track = blurred_in_time(track, throw, rng, frames)
        track = replace(track, covariance=track.covariance / 4.0)
        single.append(np.median(nees(with_calibrated_covariance(track, CUBE), throw)))
        smoothed.append(np.median(nees(smooth(track, measure(track, CUBE).throw), throw)))
    return np.array(single), np.array(smoothed)


@pytest.mark.parametrize("frames", [None, 4.0])
def test_covariances_of_frames_and_of_the_smoothed_track_are_true_for_any_correlation_time(
    frames: float | None,
) -> None:
    single, smoothed = over_seeds(frames)
    # The median of chi-square with six numbers is 5.35. A hundred independent frames determine theirs to 10 % a clip. A
    # smoothed clip has the 36 numbers of its three flights: 25 % a clip, and ten clips. Errors with a correlation time of
    # four frames, taken for independent, would make the smoothed one about 40.
    assert 4.3 < np.median(single) < 6.6
    assert 3.0 < np.median(smoothed) < 7.5


def with_contour_error(size_px: float, seed: int = 2) -> tuple[Throw, Track]:
    """A throw in the studio whose contour is taken `size_px` too far out."""
    throw, rng = lone(seed)
    track = seen(throw, rng, noise=0.3)
    jacobian = shared_bias_jacobian(track, studio().camera, CUBE)[:, :, 0]
    rotated = quat_multiply(quat_from_rotvec(size_px * jacobian[:, 3:]), track.quaternion)
    return throw, replace(track, position_m=track.position_m + size_px * jacobian[:, :3], quaternion=rotated)


def test_a_contour_taken_too_far_out_is_found_from_gravity_and_the_table() -> None:
    camera = studio().camera
    throw, track = with_contour_error(0.08)
    found = measure(track, CUBE, camera)
    sigma = float(found.chain.shared_sigma[0])
    assert sigma < 0.3 * CONTOUR_SIGMA_PX
    assert found.chain.shared[0] == pytest.approx(0.08, abs=3.0 * sigma + 0.003)
    p, _ = throw.poses(track.time_s)
    depth = camera.rotation[2]
    off = [np.abs((t.position_m - p) @ depth).mean() for t in (track, smooth(track, found.throw))]
    assert off[1] < 0.25 * off[0]


@pytest.mark.parametrize("seed", range(5))
def test_a_single_flight_leaves_the_contour_undetermined(seed: int) -> None:
    rng, camera = np.random.default_rng(seed), studio().camera
    throw = one_flight(rng)
    track = seen(throw, rng)
    by_contour = shared_bias_jacobian(track, camera, CUBE)[:, :3, 0]
    # Other faces form the contour as the die turns. An error that changes with them looks like another fall, which no error of a
    # constant contour is right to correct.
    off_px = CONTOUR_SIGMA_PX * np.linspace(-1.0, 1.0, len(track)) ** 2
    found = measure(replace(track, position_m=track.position_m + off_px[:, None] * by_contour), CUBE, camera)
    frames, along = found.smoothed_frames, camera.rotation[2]
    sigma_m = np.sqrt(np.einsum("i,nij,j->n", along, frames.covariance[:, :3, :3], along))
    assert len(found.chain.shared) == 0
    assert (sigma_m > 0.99 * CONTOUR_SIGMA_PX * np.abs(by_contour @ along)).all()
    assert (np.abs((frames.position_m - throw.poses(frames.time_s)[0]) @ along) < 2.0 * sigma_m).all()


def test_frames_that_no_flight_explains_keep_what_is_known_of_the_contour() -> None:
    camera, (throw, rng) = studio().camera, lone(2)
    track = seen(throw, rng, noise=0.3)
    off_m = np.where(np.arange(len(track)) < 8, 0.03, 0.0)[:, None] * [0.0, 1.0, 1.0]
    found = measure(replace(track, position_m=track.position_m + off_m), CUBE, camera)
    np.testing.assert_array_equal(np.flatnonzero(found.unexplained), np.arange(8))
    by_contour = shared_bias_jacobian(found.frames, camera, CUBE)[:, :3, 0] @ camera.rotation[2]
    sigma_m = np.sqrt(
        np.einsum("i,nij,j->n", camera.rotation[2], found.shared_covariance[:, :3, :3], camera.rotation[2])
    )
    before_m = CONTOUR_SIGMA_PX * np.abs(by_contour)
    assert (sigma_m > 0.99 * before_m)[found.unexplained].all()
    assert (sigma_m < 0.3 * before_m)[~found.unexplained].all()


def test_measured_frames_do_not_contain_the_shared_error() -> None:
    camera = studio().camera
    throw, track = with_contour_error(0.08)
    p, _ = throw.poses(track.time_s)
    straight = measure(track, CUBE, camera).frames
    off = [float(np.mean((t.position_m - p) @ camera.rotation[2])) for t in (track, straight)]
    assert abs(off[1]) < 0.25 * abs(off[0])
    np.testing.assert_array_equal(straight.covariance, track.covariance)


def test_a_die_of_another_size_is_not_taken_for_a_contour_error() -> None:
    camera = studio().camera
    _, track = with_contour_error(0.0)
    # Ten per cent too large, it seems ten per cent farther away.
    far = replace(track, position_m=camera.centre_m + 1.1 * (track.position_m - camera.centre_m))
    found = measure(far, make_die("cube", 0.0176, 0.0048), camera)
    assert len(found.chain.shared) == 0
    (notice,) = fall_notices(measure_fall(far, found.throw))
    assert "the lengths of [die] by 0.909" in notice


def test_without_a_contour_error_none_is_found() -> None:
    _, track = with_contour_error(0.0)
    found = measure(track, CUBE, studio().camera)
    assert abs(found.chain.shared[0]) < 3.5 * float(found.chain.shared_sigma[0])


def test_the_bias_jacobian_is_the_effect_of_a_larger_outline_on_a_pose() -> None:
    _, rng = lone(1)
    track = seen(lone(1)[0], rng, noise=1e-6)
    camera = studio().camera
    jacobian = shared_bias_jacobian(track, camera, CUBE)
    out = camera.project(CUBE.solid.vertices + track.position_m[0])
    near = camera.project(CUBE.solid.vertices + track.position_m[0] + 0.5 * jacobian[0, :3, 0])
    middle = camera.project(track.position_m[0])
    # Half a pixel out all round: corners of a hull go out by more than its sides, by up to √2 for a square one.
    grown = np.linalg.norm(near - middle, axis=1).max() - np.linalg.norm(out - middle, axis=1).max()
    assert 0.45 < grown < 0.8
    right = camera.project(track.position_m[0] + jacobian[0, :3, 1]) - middle
    np.testing.assert_allclose(right, [1.0, 0.0], atol=0.02)  # the lens bends by a per cent


def test_the_bias_jacobian_of_the_track_takes_precedence() -> None:
    throw, rng = lone(1)
    track = seen(throw, rng)
    own = np.tile(np.arange(12.0).reshape(6, 2), (len(track), 1, 1))
    jacobian = shared_bias_jacobian(replace(track, bias_jacobian=own), studio().camera, CUBE)
    np.testing.assert_array_equal(jacobian[:, :, :2], own)


def with_unknown_response(exponent_off: float, seed: int = 2) -> tuple[Throw, Track]:
    """A throw whose poses a response of unknown exponent moves: along the line of sight, and about an axis that turns with the
    die."""
    throw, rng = lone(seed)
    track = seen(throw, rng, noise=0.3)
    axes = matrix_from_quat(track.quaternion)
    contour = shared_bias_jacobian(track, studio().camera, CUBE)[:, :, 0]
    response = np.concatenate([-0.05 * contour[:, :3], 0.05 * axes[:, :, 0]], axis=1)
    turned = quat_multiply(quat_from_rotvec(exponent_off * response[:, 3:]), track.quaternion)
    moved = track.position_m + exponent_off * response[:, :3]
    bias = np.stack([contour, response], axis=2)
    return throw, replace(track, position_m=moved, quaternion=turned, bias_jacobian=bias, response_sigma=0.3)


def test_flights_determine_the_exponent_of_an_unknown_response() -> None:
    throw, track = with_unknown_response(-0.3)
    found = measure(track, CUBE, studio().camera)
    exponent, sigma = float(found.chain.shared[1]), float(found.chain.shared_sigma[1])
    assert sigma < 0.1
    assert abs(exponent + 0.3) < 3.5 * sigma
    biased = float(np.median(nees(with_calibrated_covariance(replace(track, bias_jacobian=None), CUBE), throw)))
    known = float(np.median(nees(with_calibrated_covariance(found.frames, CUBE, studio().camera), throw)))
    assert known < min(12.0, biased)


def test_the_bias_of_edges_leaves_the_places_of_marks_as_the_die_turns() -> None:
    throw, rng = lone(1)
    track, camera = seen(throw, rng), studio().camera
    rows = np.arange(len(track))
    still = np.tile(track.quaternion[:1], (len(track), 1))
    # A whole turn about the line of sight, on which the shift of the edges points everywhere.
    angle = 2.0 * np.pi * rows / len(track)
    turning = quat_multiply(quat_from_rotvec(angle[:, None] * camera.rotation[2]), still)
    across = camera.rotation[0]
    sideways = [
        np.sqrt(across @ placement_covariances(replace(track, quaternion=q), camera, CUBE, rows)[0, :3, :3] @ across)
        for q in (still, turning)
    ]
    shift_m = shared_bias_sigma(track, camera, CUBE)[1] * shared_bias_jacobian(track, camera, CUBE)[0, :3, 1] @ across
    assert sideways[0] == pytest.approx(shift_m, rel=0.1)
    assert sideways[1] < 0.1 * sideways[0]


def test_frames_without_a_pose_have_no_bias_jacobian() -> None:
    throw, rng = lone(1)
    track = seen(throw, rng)
    status = track.status.copy()
    status[4] = LOST
    jacobian = shared_bias_jacobian(replace(track, status=status), studio().camera, CUBE)
    assert np.isnan(jacobian[4]).all()
    assert np.isfinite(np.delete(jacobian, 4, axis=0)).all()


def test_rounded_corners_have_larger_shared_errors() -> None:
    throw, rng = lone(1)
    track = seen(throw, rng)
    camera = studio().camera
    assert (shared_bias_sigma(track, camera, ROUND) > 2.0 * shared_bias_sigma(track, camera, CUBE)).all()


def test_each_frame_has_its_own_shared_covariance_or_that_of_the_nearest() -> None:
    """One covariance for all frames would be wrong for a shared error along a line of sight that turns."""
    throw, rng = lone(1)
    track, camera = seen(throw, rng), studio().camera
    rays = track.position_m - camera.centre_m
    along = 1e-4 * rays / np.linalg.norm(rays, axis=1)[:, None]
    shared = np.zeros((len(track), 6, 6))
    shared[:, :3, :3] = along[:, :, None] * along[:, None]
    shared[1::2] = np.nan
    found = measure(replace(track, shared_covariance=shared), CUBE, camera)
    difference = (
        smooth(track, found.throw_without_shared_errors, found.shared_covariance).covariance
        - smooth(track, found.throw_without_shared_errors).covariance
    )
    even = np.flatnonzero(track.tracked[:-1])[::2]
    even = even[even % 2 == 0]
    np.testing.assert_allclose(difference[even], shared[even], atol=1e-15)
    # Nearest of an odd frame are both its neighbours; the later one is taken.
    np.testing.assert_allclose(difference[even[:-1] + 1], shared[even[:-1] + 2], atol=1e-15)
    # A flight takes the median one of its frames.
    flight = found.throw.flights[0]
    assert flight.covariance is not None
    assert found.throw_without_shared_errors.flights[0].covariance is not None
    constant = (flight.covariance - found.throw_without_shared_errors.flights[0].covariance)[:3, :3]
    assert np.abs(shared[even][:, :3, :3] - constant).max(axis=(1, 2)).min() < 1e-15


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_shared_error_does_not_widen_what_flights_determine_relative_to_each_other(seed: int) -> None:
    """0.4 mm and two degrees that all frames share change neither an instant nor its standard error."""
    throw, rng = lone(seed)
    track, camera = seen(throw, rng), studio().camera
    common = np.concatenate([4e-4 * np.array([0.6, 0.5, 0.6]), np.radians(2.0) * np.array([0.4, 0.8, -0.4])])
    shared = np.outer(common, common) + np.diag([1e-4**2] * 3 + [np.radians(0.5) ** 2] * 3)
    before = measure(track, CUBE, camera)
    calibrated = with_calibrated_covariance(
        replace(track, shared_covariance=np.tile(shared, (len(track), 1, 1))), CUBE, camera
    )
    again = measure(calibrated, CUBE, camera)
    for ours, theirs in zip(again.throw.impacts, before.throw.impacts, strict=True):
        assert ours.vertices == theirs.vertices
        assert ours.time_s == pytest.approx(theirs.time_s, abs=1e-3 / FPS)
        assert ours.sigma_time_s == pytest.approx(theirs.sigma_time_s, rel=0.05)
    for new, old in zip(
        again.throw_without_shared_errors.flights, before.throw_without_shared_errors.flights, strict=True
    ):
        assert new.covariance is not None
        assert old.covariance is not None
        np.testing.assert_allclose(np.diag(new.covariance), np.diag(old.covariance), rtol=0.05)
    # The covariances of single and of smoothed frames contain it once.
    assert np.linalg.eigvalsh(calibrated.covariance[0] - shared).min() > 0.0
    smoothed = smooth(again.frames_on_table, again.throw_without_shared_errors, again.shared_covariance).covariance
    assert np.linalg.eigvalsh(smoothed[0] - shared).min() > -1e-12
    assert np.trace(smoothed[0][:3, :3]) < 1.1 * np.trace(shared[:3, :3])
