"""Laws of fits that find the drag of the air: it acts to the end of the throw, on the odds, and on what is predicted."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from throws import DICE, random_release, roughly_measured, seen

from diethrow.fitting import fit_throw
from diethrow.fitting.predict.prediction import simulated_poses
from diethrow.fitting.throw.landing import continued, landing_odds, throw_of_fit
from diethrow.fitting.throw.physics import Physics
from diethrow.model.engine import FINE
from diethrow.model.laws import LEVEL, SmoothImpact
from diethrow.model.throw import HeldContact, Until, throw_die
from diethrow.model.throw.history import DraggedFlight
from diethrow.tracking.flights import perturbed

CUBE, CHI, DRAG = DICE[0], 0.5, 0.6
PHYSICS = Physics(CUBE, LEVEL, {"chi": CHI, "drag_per_m": DRAG})


def test_throws_of_a_physics_with_drag_are_those_of_the_model() -> None:
    for seed in range(5):
        start = random_release(CUBE, np.random.default_rng(seed))
        expected = throw_die(CUBE, start, SmoothImpact(CHI), drag_per_m=DRAG)
        result = PHYSICS.throw(start, Until())
        assert result.landed_face == expected.landed_face
        run = PHYSICS.run(start, impacts=1000, keep=True)
        assert run is not None
        assert run.landed_face == expected.landed_face
        assert run.vertices.tolist() == [i.vertices[0] if i.contact != "held" else -1 for i in expected.throw.impacts]
        times = np.linspace(0.0, expected.throw.impacts[2].time_s, 30)
        positions, _ = simulated_poses(PHYSICS, start, times, FINE)
        np.testing.assert_allclose(positions, expected.throw.poses(times)[0], atol=1e-10)


def test_a_throw_is_continued_against_the_drag() -> None:
    start = random_release(CUBE, np.random.default_rng(2))
    whole = throw_die(CUBE, start, SmoothImpact(CHI), until=Until(time_s=0.4), drag_per_m=DRAG).throw
    begun = throw_die(CUBE, start, SmoothImpact(CHI), until=Until(impacts=1), drag_per_m=DRAG).throw
    on = continued(PHYSICS, begun, 0.4)
    times = np.linspace(0.0, 0.4, 50)
    np.testing.assert_allclose(on.poses(times)[0], whole.poses(times)[0], atol=1e-7)


def test_the_odds_of_a_physics_with_drag_are_those_of_throws_against_it() -> None:
    rng = np.random.default_rng(0)
    start = random_release(CUBE, np.random.default_rng(7))
    spread = np.diag(np.repeat([1e-5, 2e-3, 1e-3, 0.2], 3) ** 2)
    covariance = np.pad(spread, (0, 2))
    _, odds, messages = landing_odds(PHYSICS, start, covariance, ())
    assert odds is not None
    assert sum(odds.values()) == pytest.approx(1.0)
    assert not any("drag" in message for message in messages)
    counted: Counter[int | None] = Counter()
    for _ in range(300):
        near = perturbed(start, np.sqrt(np.diag(spread)) * rng.standard_normal(12))
        counted[throw_die(CUBE, near, SmoothImpact(CHI), drag_per_m=DRAG).landed_face] += 1
    # 100 and 300 draws: a share has a standard error of at most 6 %.
    assert {face: counted[face] / 300 for face in odds} == pytest.approx(odds, abs=0.2)


def test_a_fit_that_chose_drag_has_landing_odds_and_a_throw_to_rest_against_it() -> None:
    rng = np.random.default_rng(5)
    truth = throw_die(CUBE, random_release(CUBE, rng), SmoothImpact(CHI), until=Until(impacts=3), drag_per_m=DRAG).throw
    track = seen(truth, rng, noise=0.1, stated=0.1)
    fit = fit_throw(track, roughly_measured(truth, rng), CUBE)
    assert "air drag" in fit.chosen
    drag = fit.parameters["drag_per_m"]
    assert drag.value is not None
    assert drag.low is not None
    assert drag.high is not None
    assert drag.low < DRAG < drag.high
    assert fit.face_odds is not None
    assert sum(fit.face_odds.values()) == pytest.approx(1.0)
    assert not any("drag" in message and "left out" in message for message in fit.messages)
    again = throw_of_fit(fit, CUBE, LEVEL, 2.0)
    assert again is not None
    assert again.flights[-1].end_s == pytest.approx(2.0)
    flown = [flight for flight in again.flights if not isinstance(flight, HeldContact)]
    assert len(flown) > 3
    assert all(isinstance(flight, DraggedFlight) and flight.drag_per_m == drag.value for flight in flown)
