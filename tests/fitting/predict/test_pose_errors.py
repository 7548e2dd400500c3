"""Laws of the covariances of predicted poses."""

from __future__ import annotations

import numpy as np
import pytest
from throws import random_release, seen

from diethrow.fitting.predict.pose_errors import with_covariances
from diethrow.fitting.predict.prediction import predict_track
from diethrow.fitting.predict.release_state import first_bounce_row, release_before
from diethrow.fitting.results import Misfit, Parameter, ParameterCovariance
from diethrow.fitting.throw.physics import Physics
from diethrow.model.die.die import make_die
from diethrow.model.laws import LEVEL
from diethrow.model.rotations import rotation_between
from diethrow.model.throw.simulate import Until
from diethrow.tracking.track import Track

CUBE = make_die("cube", 0.016, 0.0048)
CHI, SIGMA_CHI = 0.5, 0.02
PHYSICS = Physics(CUBE, LEVEL, {"chi": CHI})
COVARIANCE = ParameterCovariance(("chi",), np.array([[SIGMA_CHI**2]]))
PARAMETERS = {"chi": Parameter(CHI, CHI - 1.96 * SIGMA_CHI, CHI + 1.96 * SIGMA_CHI, 0.95, True, False)}
MISFIT = Misfit(np.array([0.0, 0.1]), np.array([0.0, 1e-3]), np.array([0.0, 0.02]))


def filmed(seed: int, chi: float = CHI) -> Track:
    rng = np.random.default_rng(seed)
    throw = Physics(CUBE, LEVEL, {"chi": chi}).throw(random_release(CUBE, rng), Until(impacts=2)).throw
    return seen(throw, rng, noise=0.2, stated=0.2)


def predicted(track: Track, covariance: ParameterCovariance | None, misfit: Misfit | None) -> tuple[Track, int]:
    row = first_bounce_row(track, CUBE)
    release = release_before(track, CUBE, row)
    plain = predict_track(PHYSICS, track, release)
    return with_covariances(plain, PHYSICS, release, PARAMETERS, covariance, misfit, draws=100), row


@pytest.mark.parametrize("covariance", [COVARIANCE, None], ids=["joint covariance", "intervals"])
def test_predictions_are_off_by_what_their_covariances_say(covariance: ParameterCovariance | None) -> None:
    """With χ drawn from its own error, the errors of the frames up to the second bounce have the stated size."""
    rng, ratios = np.random.default_rng(1), []
    for seed in range(24):
        track = filmed(seed, CHI + SIGMA_CHI * rng.standard_normal())
        model, row = predicted(track, covariance, None)
        rows = np.flatnonzero(model.tracked & track.tracked & (np.arange(len(track)) >= row))[:40]
        off = track.position_m[rows] - model.position_m[rows]
        turned = rotation_between(model.quaternion[rows], track.quaternion[rows])
        variances = np.diagonal(model.covariance[rows] + track.covariance[rows], axis1=1, axis2=2)
        ratios.append((np.hstack([off, turned]) ** 2 / variances).mean(0))
    # Errors of the frames of one throw are correlated, so that there are 24 samples: a mean square of 1 ± 0.3.
    assert np.mean(ratios, axis=0) == pytest.approx(np.ones(6), abs=0.9)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.5)


def test_what_the_law_misses_is_added() -> None:
    track = filmed(3)
    (plain, row), (wider, _) = predicted(track, COVARIANCE, None), predicted(track, COVARIANCE, MISFIT)
    rows = np.flatnonzero(np.isfinite(plain.covariance[:, 0, 0]))
    assert rows[0] <= row
    added = wider.covariance[rows] - plain.covariance[rows]
    since = track.time_s[rows] - release_before(track, CUBE, row).state.time_s
    part = np.minimum(since / 0.1, 1.0)
    np.testing.assert_allclose(added[:, 0, 0], 1e-6 * part, atol=1e-16)
    np.testing.assert_allclose(added[:, 5, 5], 4e-4 * part, atol=1e-16)
    np.testing.assert_allclose(added[:, 0, 3:], 0.0, atol=1e-16)


def test_covariances_are_symmetric_and_grow_with_the_errors_of_the_parameters() -> None:
    track = filmed(4)
    small, _ = predicted(track, ParameterCovariance(("chi",), np.array([[1e-8]])), None)
    large, _ = predicted(track, COVARIANCE, None)
    rows = np.flatnonzero(np.isfinite(large.covariance[:, 0, 0]))
    np.testing.assert_allclose(large.covariance[rows], np.swapaxes(large.covariance[rows], 1, 2))
    assert np.linalg.eigvalsh(large.covariance[rows]).min() > -1e-12
    assert np.trace(large.covariance[rows[-1]]) > 10.0 * np.trace(small.covariance[rows[-1]])


def test_frames_up_to_the_release_state_have_none() -> None:
    track = filmed(5)
    model, row = predicted(track, COVARIANCE, MISFIT)
    release = release_before(track, CUBE, row)
    assert np.isnan(model.covariance[track.time_s <= release.state.time_s]).all()
