"""Laws of the fit of a whole throw: the known truth is found, inside the stated intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from intervals import assert_inside
from random_throws import state_difference
from throws import (
    blurred_in_time,
    random_release,
    roughly_measured,
    seen,
    true_throw,
)

from diethrow.fitting.results import Choices, Fit
from diethrow.fitting.throw.throw_fit import fit_throw
from diethrow.model.die.die import Die, make_die
from diethrow.model.laws import Table
from diethrow.model.rotations import quat_from_rotvec, quat_multiply
from diethrow.model.throw.motion import Impact, Throw
from diethrow.tracking.track import ABSENT, LOST, Track

CUBE = make_die("cube", 0.016, 0.0048)
TETRAHEDRON = make_die("tetrahedron", 0.022, 0.0015)
ICOSAHEDRON = make_die("icosahedron", 0.0105, 0.003)


def cube_throw(chi: float = 0.58, impacts: int = 3, seed: int = 2) -> tuple[Throw, Track, Throw]:
    """Truth, track and measured throw of a cube whose flights all last several frames."""
    rng = np.random.default_rng(seed)
    throw = true_throw(CUBE, random_release(CUBE, rng), chi, impacts=impacts)
    return throw, seen(throw, rng), roughly_measured(throw, rng)


def chi_of(fit: Fit) -> tuple[float, float, float]:
    """Value and interval of χ, which must exist."""
    chi = fit.parameters["chi"]
    assert chi.value is not None
    assert chi.low is not None
    assert chi.high is not None
    return chi.value, chi.low, chi.high


@pytest.mark.parametrize(
    "frames_correlated", [0.0, 4.0], ids=["independent errors", "errors correlated over four frames"]
)
def test_intervals_and_covariances_have_their_stated_coverage(frames_correlated: float) -> None:
    dice, held, nees = (CUBE, TETRAHEDRON, ICOSAHEDRON), [], []
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        die, chi = dice[seed % 3], rng.uniform(0.2, 0.9)
        throw = true_throw(die, random_release(die, rng), chi, impacts=int(rng.integers(1, 5)))
        track = seen(throw, rng)
        if frames_correlated:
            track = blurred_in_time(track, throw, rng, frames_correlated)
        fit = fit_throw(track, roughly_measured(throw, rng), die)
        if fit.parameters["chi"].value is None:
            continue  # no flight after a bounce lasted two frames
        value, low, high = chi_of(fit)
        held.append(low <= chi <= high)
        assert abs(value - chi) < 0.05
        assert fit.initial is not None
        assert fit.initial_covariance is not None
        error = state_difference(fit.initial, throw.flights[0].at(fit.initial.time_s))
        nees.append(float(error @ np.linalg.solve(fit.initial_covariance, error)))
    assert len(held) >= 30
    # Of 30 to 40 throws, fewer than 88 % inside a true 95 % interval has odds of about one in fifty, fewer than 82 % of one
    # in a thousand: allowed where the correlation of the errors has to be estimated from few frames.
    assert np.mean(held) >= (0.82 if frames_correlated else 0.88)
    # The median of χ² with twelve degrees of freedom is 11.3, and that of 35 values has a standard deviation of 1.0.
    assert 8.0 < np.median(nees) < (18.0 if frames_correlated else 14.5)


@pytest.mark.parametrize("die", [CUBE, TETRAHEDRON, ICOSAHEDRON], ids=lambda die: die.solid.name)
def test_almost_without_noise_the_fit_is_the_truth(die: Die) -> None:
    rng = np.random.default_rng(5)
    throw = true_throw(die, random_release(die, rng), 0.55, impacts=3)
    fit = fit_throw(seen(throw, rng, noise=1e-4), roughly_measured(throw, rng), die)
    value, low, high = chi_of(fit)
    # With the errors of tracking χ is known to 1e-4; with errors ten thousand times smaller, to about 1e-8.
    assert abs(value - 0.55) < 1e-6
    assert low <= 0.55 <= high
    assert fit.throw is not None
    assert [i.vertices for i in fit.throw.impacts][:3] == [i.vertices for i in throw.impacts]


def test_a_throw_without_bounce_does_not_determine_chi() -> None:
    throw, track, measured = cube_throw()
    before = track.time_s < throw.impacts[0].time_s
    fit = fit_throw(masked(track, before), Throw(measured.flights[:1], ()), CUBE)
    assert fit.parameters["chi"].value is None
    assert fit.parameters["chi"].low is None
    assert any("no bounce" in words for words in fit.messages)
    assert fit.initial is not None
    assert fit.bounces_fitted == 0


def test_one_frame_after_the_bounce_does_not_determine_chi() -> None:
    throw, track, measured = cube_throw()
    until = track.time_s[np.searchsorted(track.time_s, throw.impacts[0].time_s) + 1]
    short = Throw(measured.flights[:2], measured.impacts[:1])
    fit = fit_throw(masked(track, track.time_s <= until), short, CUBE)
    assert fit.parameters["chi"].value is None
    assert any("two frames" in words for words in fit.messages)


def test_a_single_frame_determines_nothing() -> None:
    _, track, measured = cube_throw()
    fit = fit_throw(masked(track, track.frame == 3), measured, CUBE)
    assert fit.parameters["chi"].value is None
    assert fit.initial is None
    assert fit.throw is None
    assert any("two frames" in words for words in fit.messages)


def test_bad_frames_do_not_move_chi() -> None:
    _, track, measured = cube_throw()
    without_bad, low, high = chi_of(fit_throw(track, measured, CUBE))
    rng = np.random.default_rng(0)
    bad = rng.choice(np.arange(5, len(track) - 5), 8, replace=False)
    position, quaternion = track.position_m.copy(), track.quaternion.copy()
    position[bad] += 3e-3 * rng.standard_normal((8, 3))
    quaternion[bad] = quat_multiply(quat_from_rotvec(rng.standard_normal((8, 3))), quaternion[bad])
    value, _, _ = chi_of(fit_throw(replace(track, position_m=position, quaternion=quaternion), measured, CUBE))
    # Eight frames fewer shift the value within its sigma (a quarter of the interval); their errors do not.
    assert abs(value - without_bad) < 0.25 * (high - low)


def test_lost_frames_and_gaps_are_skipped() -> None:
    _, track, measured = cube_throw()
    status = track.status.copy()
    status[10:30], status[40:43] = LOST, ABSENT
    position = track.position_m.copy()
    position[10:30] = np.nan
    value, low, high = chi_of(fit_throw(replace(track, status=status, position_m=position), measured, CUBE))
    assert low <= 0.58 <= high
    assert abs(value - 0.58) < 1e-3


@pytest.mark.parametrize("broken", ["missing", "singular", "some missing"])
def test_unusable_covariances_are_estimated_and_reported(broken: str) -> None:
    _, track, measured = cube_throw()
    covariance = track.covariance.copy()
    if broken == "missing":
        covariance[:] = np.nan
    elif broken == "singular":
        covariance[:, 5, :] = covariance[:, :, 5] = 0.0
    else:
        covariance[::3] = np.nan
    fit = fit_throw(replace(track, covariance=covariance), measured, CUBE)
    _, low, high = chi_of(fit)
    assert any("no usable covariance" in words for words in fit.messages)
    # One sigma for all axes is a poor weight for noise that is seven times larger along the line of sight: the interval
    # is wider than with the true weights, but contains the truth.
    assert low <= 0.58 <= high
    assert high - low < 0.01


def test_sigmas_stated_three_times_too_small_do_not_narrow_the_interval() -> None:
    _, track, measured = cube_throw()
    true_sigmas = fit_throw(track, measured, CUBE)
    small_sigmas = fit_throw(replace(track, covariance=track.covariance / 9.0), measured, CUBE)
    _, low, high = chi_of(true_sigmas)
    _, low3, high3 = chi_of(small_sigmas)
    # The scale is estimated from some hundred frames, within 5 %; true sigmas are not scaled down.
    assert (high3 - low3) / (high - low) == pytest.approx(1.0, abs=0.1)
    assert small_sigmas.residual_rms == pytest.approx(3.0, rel=0.1)
    assert any("scatter" in words for words in small_sigmas.messages)


def test_another_die_is_not_explained() -> None:
    _, track, measured = cube_throw()
    larger = make_die("cube", 0.024, 0.0162)
    fit = fit_throw(track, measured, larger)
    assert fit.bounces_fitted == 0
    assert any("explains 0 of 3" in words for words in fit.messages)
    assert fit.residual_rms is None or fit.residual_rms > 5.0


def test_a_wrongly_measured_vertex_is_corrected() -> None:
    throw, track, measured = cube_throw()
    wrong = replace(measured.impacts[1], vertices=((throw.impacts[1].vertices[0] + 3) % 8,))
    fit = fit_throw(track, Throw(measured.flights, (measured.impacts[0], wrong, measured.impacts[2])), CUBE)
    assert fit.bounces_fitted == 3
    assert fit.throw is not None
    assert fit.throw.impacts[1].vertices == throw.impacts[1].vertices


def test_a_spurious_bounce_is_skipped() -> None:
    _, track, measured = cube_throw()
    k = int(np.argmax([f.end_s - f.start.time_s for f in measured.flights[1:-1]])) + 1
    middle = 0.5 * (measured.flights[k].start.time_s + measured.flights[k].end_s)
    false = replace(measured.impacts[k], time_s=middle, vertices=(0,))
    flights = (*measured.flights[: k + 1], measured.flights[k], *measured.flights[k + 1 :])
    impacts = (*measured.impacts[:k], false, *measured.impacts[k:])
    fit = fit_throw(track, Throw(flights, impacts), CUBE)
    assert fit.bounces_fitted == 4
    assert any("3 impacts where 4 bounces" in words for words in fit.messages)
    _, low, high = chi_of(fit)
    assert low <= 0.58 <= high


def test_an_unresolved_contact_is_resolved() -> None:
    """A tetrahedron that strikes with several corners within few frames, measured as one unresolved contact."""
    throw, track, measured = throw_with_contact_cluster()
    assert len(throw.impacts) >= 4
    first, last = throw.impacts[1].time_s, throw.impacts[-2].time_s
    assert last - first < 6.0 / 1500.0
    unknown = Impact(
        0.5 * (first + last), "unresolved", (), np.full(2, np.nan), np.full(3, np.nan), *[np.nan] * 4, 1, 1
    )
    merged = Throw(
        (measured.flights[0], measured.flights[1], *measured.flights[-2:]),
        (measured.impacts[0], unknown, measured.impacts[-1]),
    )
    fit = fit_throw(track, merged, TETRAHEDRON)
    _, low, high = chi_of(fit)
    assert fit.throw is not None
    assert [i.vertices for i in fit.throw.impacts][: len(throw.impacts)] == [i.vertices for i in throw.impacts]
    assert low <= 0.55 <= high


def test_the_interval_of_an_elastic_throw_ends_at_one() -> None:
    rng = np.random.default_rng(11)
    throw = true_throw(CUBE, random_release(CUBE, rng), 1.0, impacts=1)
    fit = fit_throw(seen(throw, rng, noise=5.0), roughly_measured(throw, rng), CUBE)
    value, low, high = chi_of(fit)
    assert 0.9 < low < value <= high == 1.0
    assert fit.parameters["chi"].at_bound == (value == 1.0)


def test_rounded_corners_enter_the_model() -> None:
    """The throw of the shrunk sharp die, raised by the radius, is the throw of the rounded die."""
    rng = np.random.default_rng(4)
    radius = 0.0006
    rounded = make_die("cube", 0.016, 0.0048, corner_radius_m=radius)
    shrunk = Die(make_die("cube", 0.016 - 2.0 * radius, 1.0).solid, 0.0048, rounded.inertia_kg_m2)
    sharp = true_throw(shrunk, random_release(shrunk, rng), 0.4, impacts=3)
    lift = np.array([0.0, 0.0, radius])
    raised = Throw(
        tuple(replace(f, start=replace(f.start, position_m=f.start.position_m + lift)) for f in sharp.flights),
        sharp.impacts,
    )
    fit = fit_throw(seen(raised, rng), roughly_measured(raised, rng), rounded)
    _, low, high = chi_of(fit)
    assert low <= 0.4 <= high
    assert fit.bounces_fitted == 3
    assert "rounded corners" in fit.chosen
    assert fit.throw is not None
    # Noise of some hundredths of a millimetre, averaged over a flight.
    error = fit.throw.poses([0.01])[0] - raised.poses([0.01])[0]
    assert np.linalg.norm(error) < 5e-5


def test_columns_of_different_length_are_refused() -> None:
    _, track, measured = cube_throw()
    with pytest.raises(ValueError, match="track columns of shapes"):
        fit_throw(replace(track, covariance=track.covariance[:-1]), measured, CUBE)


def masked(track: Track, kept: np.ndarray) -> Track:
    """Only some of the frames."""
    return Track(
        track.frame[kept],
        track.time_s[kept],
        track.position_m[kept],
        track.quaternion[kept],
        track.covariance[kept],
        track.status[kept],
    )


def throw_with_contact_cluster() -> tuple[Throw, Track, Throw]:
    """The first seed whose tetrahedron has all impacts but the first and the last within six frames."""
    for seed in range(4000):
        rng = np.random.default_rng(seed)
        throw = true_throw(TETRAHEDRON, random_release(TETRAHEDRON, rng), 0.55, impacts=5)
        gaps = np.diff([i.time_s for i in throw.impacts]) * 1500.0
        cluster = len(gaps) == 4 and gaps[0] > 5.0 and gaps[1] + gaps[2] < 6.0 and gaps[1] > 0.1 and gaps[3] > 12.0
        if cluster and (throw.flights[-1].end_s - throw.impacts[-1].time_s) * 1500.0 > 10.0:
            return throw, seen(throw, rng), roughly_measured(throw, rng)
    raise AssertionError("no such throw")


def test_the_three_kinds_of_interval_agree_where_noise_is_normal() -> None:
    """A bootstrap of 200 draws places each end of an interval to a tenth of its width; a quarter is a wide margin."""
    _, track, measured = cube_throw(impacts=2)
    profile, covariance, bootstrap = (
        chi_of(fit_throw(track, measured, CUBE, choices=Choices(kind)))
        for kind in ("profile", "covariance", "bootstrap")
    )
    width = profile[2] - profile[1]
    assert covariance == pytest.approx(profile, abs=0.02 * width)
    assert bootstrap == pytest.approx(profile, abs=0.25 * width)


@pytest.mark.parametrize("seed", [2, 8])
def test_the_profile_follows_the_bends_of_a_long_valley(seed: int) -> None:
    """With four bounces and nearly noiseless frames the cost is quadratic far beyond the interval, so profile and
    covariance agree. A descent that stops early makes the interval hundreds of times too narrow."""
    rng = np.random.default_rng(seed)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.58, impacts=4)
    track, measured = seen(throw, rng, noise=0.05, stated=0.05), roughly_measured(throw, rng)
    profile, covariance = (
        chi_of(fit_throw(track, measured, CUBE, choices=Choices(k))) for k in ("profile", "covariance")
    )
    assert profile[2] - profile[1] == pytest.approx(covariance[2] - covariance[1], rel=0.01)


def test_a_throw_of_many_bounces_is_fitted_as_far_as_double_precision_carries() -> None:
    """Errors of the initial state grow up to a hundredfold at a bounce; chi is known long before rounding matters."""
    rng = np.random.default_rng(3)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.9, impacts=12)
    fit = fit_throw(seen(throw, rng), roughly_measured(throw, rng), CUBE)
    assert 5 <= fit.bounces_fitted < 12
    assert any(f"explains {fit.bounces_fitted} of 12 bounces" in m and "double precision" in m for m in fit.messages)
    assert fit.chosen == ("smooth impact",)
    assert_inside(fit, "chi", 0.9, 1e-4)


def test_a_table_and_a_track_under_different_gravity_are_refused() -> None:
    _, track, measured = cube_throw()
    with pytest.raises(ValueError, match=r"gravity_m_s2 = 1\.62 of the table and 9\.81 of the track"):
        fit_throw(track, measured, CUBE, Table(gravity_m_s2=1.62))


def test_poses_that_no_flight_explains_change_nothing() -> None:
    _, track, measured = cube_throw()
    wrong = np.abs(track.time_s - measured.impacts[1].time_s - 0.01) < 0.006
    assert wrong.sum() > 10
    position = track.position_m + 2e-3 * wrong[:, None]
    doubted = fit_throw(replace(track, position_m=position, unexplained=wrong), measured, CUBE)
    without = fit_throw(replace(track, status=np.where(wrong, LOST, track.status)), measured, CUBE)
    assert chi_of(doubted) == chi_of(without)
    assert chi_of(doubted) != chi_of(fit_throw(replace(track, position_m=position), measured, CUBE))
