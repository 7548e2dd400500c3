"""Marks and edges measure one motion: what contradicts is an error that neither had stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from marked_throws import STUDIO, VIEW, learned_marks

from diethrow.model.throw.motion import Throw
from diethrow.tracking.sequence.refine_on_marks import with_placement_error


@pytest.mark.parametrize("sigma_m", [1e-6, 1e-3], ids=["contradicting", "agreeing"])
def test_what_contradicts_the_edges_is_a_common_error_of_the_marks(sigma_m: float) -> None:
    # The flights by edges lie 0.05 mm beside those by marks. Only a difference that the covariances leave open adds nothing.
    marks, sideways_m = learned_marks()[0], 5e-5
    covariance = np.diag([sigma_m**2] * 3 + [1e-8] * 3 + [1e-10] * 3 + [1e-6] * 3)
    by_marks = replace(marks.flights[0], covariance=covariance)
    start = replace(by_marks.start, position_m=by_marks.start.position_m + sideways_m * STUDIO.camera.rotation[0])
    by_edges = Throw((replace(by_marks, start=start),), ())
    placed = with_placement_error(VIEW, replace(marks, flights=(by_marks,)), by_edges)
    # The median of chi-square with six is 2.31 squared.
    expected = sideways_m / 2.31 if sigma_m < sideways_m else 0.0
    assert placed.placement_m == pytest.approx(expected, rel=0.05)
