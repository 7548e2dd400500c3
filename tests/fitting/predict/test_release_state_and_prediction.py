"""Laws of predictions: release states use no later frame, and predictions agree with the simulated truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_throws import state_difference
from throws import random_release, seen

from diethrow.fitting.predict.prediction import DECISION_SHARE, decide, predict_track, simulated_poses
from diethrow.fitting.predict.release_state import first_bounce_row, release_before
from diethrow.fitting.results import Parameter
from diethrow.fitting.throw.physics import CENTRE_OF_MASS, Physics
from diethrow.model import engine
from diethrow.model.die.die import make_die
from diethrow.model.laws import LEVEL, Table
from diethrow.model.rotations import matrix_from_quat, rotation_between
from diethrow.model.throw.motion import State, Throw, energy_J
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.model.world import GRAVITY_M_S2
from diethrow.tracking.track import Track

CUBE = make_die("cube", 0.016, 0.0048, corner_radius_m=0.0005)
VALUES = {
    "smooth": {"chi": 0.5},
    "friction": {"chi": 0.4, "mu": 0.2},
    "fading restitution and friction": {"chi": 0.5, "mu": 0.3, "chi_fade_s_per_m": 0.5, "mu_fade_s_per_m": 0.5},
}


def physics(name: str, table: Table = LEVEL) -> Physics:
    return Physics(CUBE, table, VALUES[name])


def thrown(name: str, seed: int = 0, *, duration_s: float = 0.35) -> tuple[State, Throw]:
    release = random_release(CUBE, np.random.default_rng(seed))
    return release, physics(name).throw(release, Until(time_s=duration_s)).throw


def filmed(name: str = "friction", seed: int = 0, noise: float = 0.1) -> tuple[Track, Throw]:
    _, throw = thrown(name, seed)
    return seen(throw, np.random.default_rng(seed + 1), noise=noise), throw


@pytest.mark.parametrize("name", VALUES)
def test_compiled_poses_are_those_of_the_throw(name: str) -> None:
    release, throw = thrown(name)
    times = np.linspace(0.0, 0.35, 300)
    # Until rest, so that held contact is included; both use the same kernel with the same precision.
    positions, quaternions = simulated_poses(physics(name), release, times, engine.FINE)
    expected_positions, expected_quaternions = throw.poses(times)
    assert any(impact.contact == "held" for impact in throw.impacts)
    assert positions == pytest.approx(expected_positions, abs=1e-12)
    assert np.abs(rotation_between(quaternions, expected_quaternions)).max() < 1e-11


def test_a_tilted_table_tilts_the_prediction() -> None:
    tilted = physics("smooth", Table(tilt_rad=0.05))
    release, _ = thrown("smooth")
    times = np.linspace(0.0, 0.12, 40)
    positions, _ = simulated_poses(tilted, release, times)
    throw = throw_die(CUBE, release, tilted.law, until=Until(time_s=0.12), table=tilted.table).throw
    assert positions == pytest.approx(throw.poses(times)[0], abs=1e-9)


def test_clock_and_length_scales_change_units_only() -> None:
    release, throw = thrown("friction")
    times = np.linspace(0.0, 0.2, 50)
    scaled = physics("friction").with_values(clock_scale=1.01, length_scale=0.98)
    seen_release = State(
        0.0,
        0.98 * release.position_m,
        release.quaternion,
        0.98 * 1.01 * release.velocity_m_s,
        1.01 * release.omega_rad_s,
    )
    positions, _ = simulated_poses(scaled, seen_release, times / 1.01)
    # The coarser precision of predictions leaves a thousandth of an edge.
    assert positions == pytest.approx(0.98 * throw.poses(times)[0], abs=1.6e-5)


def test_the_first_bounce_is_found_to_the_frame() -> None:
    for seed in range(6):
        track, throw = filmed(seed=seed)
        after = int(np.searchsorted(track.time_s, throw.impacts[0].time_s))
        # The frame taken just before or after a bounce may agree with either flight.
        assert abs(first_bounce_row(track, CUBE) - after) <= 1


def test_one_bad_frame_is_not_taken_for_a_bounce() -> None:
    track, throw = filmed()
    position = track.position_m.copy()
    position[30] += 0.002
    after = int(np.searchsorted(track.time_s, throw.impacts[0].time_s))
    assert abs(first_bounce_row(replace(track, position_m=position), CUBE) - after) <= 1


def test_the_release_state_does_not_depend_on_later_frames() -> None:
    track, _ = filmed()
    row = first_bounce_row(track, CUBE)
    later = track.position_m.copy()
    later[row:] += 0.05
    one, other = release_before(track, CUBE, row), release_before(replace(track, position_m=later), CUBE, row)
    assert np.array_equal(one.state.position_m, other.state.position_m)
    assert np.array_equal(one.rows, other.rows)


def test_the_covariance_of_the_release_state_has_the_size_of_its_errors() -> None:
    ratios = []
    for seed in range(40):
        track, throw = filmed(seed=seed, noise=1.0)
        estimated = release_before(track, CUBE, first_bounce_row(track, CUBE) - 3)
        errors = state_difference(estimated.state, throw.at(estimated.state.time_s))
        ratios.append(errors @ np.linalg.solve(estimated.covariance, errors) / 12.0)
    # Errors are larger along the line of sight than across, while one sigma stands for all axes: not χ² of twelve degrees
    # of freedom, but the same mean of 1, here of 40 values with a standard deviation of about 0.5.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.3)


def test_a_prediction_almost_without_noise_is_the_throw() -> None:
    track, throw = filmed(noise=1e-6)
    row = first_bounce_row(track, CUBE)
    estimated = release_before(track, CUBE, row)
    predicted = predict_track(physics("friction"), track, estimated)
    assert predicted.tracked.all()
    # Over two bounces an error of the state of 1e-10 m grows some four hundredfold.
    until = np.searchsorted(track.time_s, throw.bounces[2].time_s)
    assert predicted.position_m[:until] == pytest.approx(throw.poses(track.time_s[:until])[0], abs=1e-6)


def test_two_frames_are_a_start_with_the_errors_that_the_track_states() -> None:
    """The squared Mahalanobis distance of twelve normal numbers: 12 on average, with a variance of 24."""
    squared, throws = [], [thrown("smooth", seed, duration_s=0.01)[1] for seed in range(20)]
    for seed in range(400):
        throw = throws[seed % len(throws)]
        track = seen(throw, np.random.default_rng(1000 + seed), noise=1.0)
        found = release_before(track, CUBE, 2)
        assert list(found.rows) == [0, 1]
        off = state_difference(found.state, throw.at(found.state.time_s))
        squared.append(off @ np.linalg.solve(found.covariance, off))
    assert np.mean(squared) == pytest.approx(12.0, abs=4.0 * np.sqrt(24.0 / len(squared)))


def test_two_frames_behind_a_bounce_have_the_errors_of_the_flight_before() -> None:
    track, _ = filmed(noise=1.0)
    row = first_bounce_row(track, CUBE)
    before, after = release_before(track, CUBE, row), release_before(track, CUBE, row + 2)
    assert list(after.rows) == [row, row + 1]
    assert (after.sigma_m, after.sigma_rad) == pytest.approx((before.sigma_m, before.sigma_rad))
    # Two frames say as much of a velocity as their distance allows.
    frame_s = track.time_s[row + 1] - track.time_s[row]
    np.testing.assert_allclose(np.diag(after.covariance)[6:9], 2.0 * before.sigma_m**2 / frame_s**2, rtol=1e-6)


def test_the_face_of_a_completed_throw_is_decided() -> None:
    track, throw = filmed(noise=1.0)
    parameters = {name: Parameter(value, None, None, None, False, False) for name, value in VALUES["friction"].items()}
    row = first_bounce_row(track, CUBE)
    decision = decide(physics("friction"), parameters, track, row, draws=20)
    landed = int(np.argmin(CUBE.solid.normals @ throw.at(0.35).rotation[2])) + 1
    assert decision.face == landed
    assert decision.steps[-1].odds[landed] >= DECISION_SHARE
    assert all(sum(s.odds.values()) + s.undecided == pytest.approx(1.0) for s in decision.steps)


def test_a_track_that_cannot_be_predicted_is_refused_with_the_reason() -> None:
    track, _ = filmed()
    row = first_bounce_row(track, CUBE)
    with pytest.raises(ValueError, match="at least 3, or 2 whose errors the track states"):
        release_before(track, CUBE, 1)
    silent = replace(track, covariance=np.full((len(track), 6, 6), np.nan))
    with pytest.raises(ValueError, match="at least 3, or 2 whose errors the track states"):
        release_before(silent, CUBE, 2)
    with pytest.raises(ValueError, match=f"before row {row + 1}"):
        release_before(track, CUBE, row + 1)
    flying = replace(track, status=np.where(np.arange(len(track)) < row - 1, track.status, "lost"))
    with pytest.raises(ValueError, match="never bounces"):
        first_bounce_row(flying, CUBE)
    backwards = track.time_s.copy()
    backwards[9] = backwards[7]
    with pytest.raises(ValueError, match="does not rise"):
        first_bounce_row(replace(track, time_s=backwards), CUBE)


LOADED = {**dict(zip(CENTRE_OF_MASS, (3e-4, -2e-4, 8e-4), strict=True)), "chi": 0.5}


@pytest.mark.parametrize("table", [LEVEL, Table(tilt_rad=0.05, downhill_rad=0.4)])
def test_a_loaded_die_is_predicted_as_the_asymmetric_model_throws_it(table: Table) -> None:
    release = random_release(CUBE, np.random.default_rng(1))
    times = np.linspace(0.0, 0.2, 60)
    throw = Physics(CUBE, table, LOADED).throw(release, Until(time_s=0.2)).throw
    expected = throw.poses(times)
    for mu, tolerance in ((0.0, 1e-10), (1e-9, 1e-6)):
        # Without friction both are exact, by different equations; a trace of friction makes a trace of a difference.
        positions, _ = simulated_poses(Physics(CUBE, table, {**LOADED, "mu": mu}), release, times, engine.FINE)
        assert positions == pytest.approx(expected[0], abs=tolerance)


def test_a_loaded_die_with_friction_ends_on_a_face_and_gains_no_energy() -> None:
    frictional = Physics(CUBE, LEVEL, {**LOADED, "mu": 0.3})
    times = np.linspace(0.0, 1.0, 200)
    for seed in range(4):
        release = random_release(CUBE, np.random.default_rng(seed))
        positions, quaternions = simulated_poses(frictional, release, times, engine.FINE)
        rotations = matrix_from_quat(quaternions)
        face = int(np.argmin(rotations[-1, 2] @ CUBE.solid.normals.T))
        assert rotations[-1, 2] @ CUBE.solid.normals[face] == pytest.approx(-1.0, abs=1e-8)
        # Rest is declared when the die rocks by no more than hundredths of a milliradian.
        assert positions[-1, 2] == pytest.approx(0.008, abs=1e-6)
        heights = positions[:, 2] + rotations[:, 2] @ np.array([LOADED[name] for name in CENTRE_OF_MASS])
        potential = CUBE.mass_kg * GRAVITY_M_S2 * heights
        assert (potential <= energy_J(frictional.body, release) + 1e-12).all()


def test_the_release_state_of_a_loaded_die_is_that_of_its_centroid() -> None:
    loaded = Physics(CUBE, LEVEL, LOADED)
    release = random_release(CUBE, np.random.default_rng(3), spin_rad_s=60.0)
    throw = loaded.throw(release, Until(time_s=0.12)).throw
    track = seen(throw, np.random.default_rng(0), noise=1e-6)
    row = int(np.searchsorted(track.time_s, throw.impacts[0].time_s))
    estimated = release_before(track, loaded.body, row)
    true = throw.at(estimated.state.time_s)
    # As a fair die it would be off by ω² s t, centimetres per second.
    assert estimated.state.velocity_m_s == pytest.approx(true.velocity_m_s, abs=1e-5)
    assert estimated.state.position_m == pytest.approx(true.position_m, abs=1e-7)
    assert estimated.poses(track.time_s[estimated.rows])[0] == pytest.approx(track.position_m[estimated.rows], abs=1e-6)
