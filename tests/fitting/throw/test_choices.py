"""What a fit assumes beside the frames: each choice does what its name says, and is checked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from throws import random_release, roughly_measured, seen, thrown, true_throw

from diethrow.fitting.results import USUAL_CHOICES, Choices
from diethrow.fitting.throw.throw_fit import fit_throw
from diethrow.model.die.die import make_die
from diethrow.model.laws import CoulombImpact

CUBE = make_die("cube", 0.016, 0.0048)


def test_a_fit_says_what_it_was_made_with() -> None:
    track, measured = thrown(CUBE, CoulombImpact(0.6, 0.0), 4, impacts=1)
    assert fit_throw(track, measured, CUBE).choices == USUAL_CHOICES
    chosen = Choices("covariance", 3.0, None)
    assert fit_throw(track, measured, CUBE, choices=chosen).choices == chosen


@pytest.mark.parametrize(
    ("name", "value"), [("misfit_limit", 1.0), ("misfit_limit", 9.0), ("usual_friction", 0.0), ("usual_friction", 4.0)]
)
def test_a_choice_outside_its_range_is_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name} = {value}: wanted"):
        replace(USUAL_CHOICES, **{name: value})


def test_the_reported_friction_is_the_usual_one_where_the_frames_allow_any() -> None:
    """The slip of this one bounce stops for every mu from 0.15 on."""
    track, measured = thrown(CUBE, CoulombImpact(0.535, 0.27), 8, impacts=1)
    found = {}
    for usual in (0.3, 1.0, None):
        fit = fit_throw(track, measured, CUBE, choices=Choices("covariance", usual_friction=usual))
        mu = fit.parameters["mu"].value
        assert mu is not None
        found[usual] = mu, fit.residual_rms
    assert abs(np.log(found[0.3][0] / 0.3)) < abs(np.log(found[1.0][0] / 0.3))
    assert abs(np.log(found[1.0][0] / 1.0)) < abs(np.log(found[0.3][0] / 1.0))
    # None of them explains the frames better.
    np.testing.assert_allclose([rms for _, rms in found.values()], found[None][1], rtol=1e-3)


def test_a_fit_goes_on_as_long_as_its_misfit_limit_allows() -> None:
    """Frames behind the second bounce that lie 3.7 sigma aside: a ratio of 1.8 that no law of impact explains."""
    rng = np.random.default_rng(2)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.58, impacts=3)
    track, measured = seen(throw, rng), roughly_measured(throw, rng)
    behind = track.time_s > throw.impacts[1].time_s
    aside = np.linalg.cholesky(track.covariance[behind])[:, :3, :3] @ np.array([3.7, 0.0, 0.0])
    position = track.position_m.copy()
    position[behind] += aside
    moved = replace(track, position_m=position)
    bounces = [
        fit_throw(moved, measured, CUBE, choices=Choices("covariance", limit)).bounces_fitted
        for limit in (1.5, 2.5, 4.0)
    ]
    assert bounces[0] < 3
    assert bounces[1:] == [3, 3]
