"""Laws of throws in fixed steps: they come to what the events say as the steps shrink."""

from __future__ import annotations

import numpy as np
import pytest

from diethrow.model.die.die import make_die
from diethrow.model.ensembles.landings import ThrowSetup
from diethrow.model.ensembles.releases import UniformConditions, drawn_states
from diethrow.model.ensembles.stepping import stepped_landings
from diethrow.model.laws import SmoothImpact

CUBE = make_die("cube", 0.02, 0.016)


def releases(count: int) -> np.ndarray:
    return drawn_states(UniformConditions(20.0, (0.04, 0.08)), CUBE, 3, 0, count)


def test_smaller_steps_land_more_often_where_events_do() -> None:
    """Throws from a few centimetres at χ 0.2, which a step of 20 µs follows through most of their impacts."""
    starts = releases(300)
    exact = ThrowSetup(CUBE, SmoothImpact(0.2)).throw(starts).face
    alike = [float((stepped_landings(CUBE, 0.2, starts, step_s) == exact).mean()) for step_s in (2e-3, 2e-4, 2e-5)]
    assert alike[0] < alike[1] < alike[2]
    assert alike[2] > 0.95


def test_single_precision_is_another_throw_only_where_it_is_sensitive() -> None:
    starts = releases(300)
    double = stepped_landings(CUBE, 0.2, starts, 2e-4)
    single = stepped_landings(CUBE, 0.2, starts, 2e-4, single=True)
    assert 0.9 < (single == double).mean() <= 1.0


def test_all_land_on_a_face_of_the_die() -> None:
    faces = stepped_landings(CUBE, 0.5, releases(100), 1e-3)
    assert set(np.unique(faces)) <= set(range(1, 7))


@pytest.mark.parametrize(("values", "message"), [({"chi": 1.5}, r"chi = 1\.5"), ({"step_s": 0.0}, r"step_s = 0\.0")])
def test_what_the_method_does_not_have_is_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        stepped_landings(CUBE, **{"chi": 0.5, "starts": releases(1), "step_s": 1e-3, **values})  # type: ignore[arg-type]


def test_a_rounded_die_is_refused() -> None:
    rounded = make_die("cube", 0.02, 0.016, corner_radius_m=1e-3)
    with pytest.raises(ValueError, match="sharp spherical top"):
        stepped_landings(rounded, 0.5, releases(1), 1e-3)
