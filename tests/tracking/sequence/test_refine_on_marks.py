"""Marks and edges measure one motion: what contradicts is an error that neither had stated."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from marked_throws import STUDIO, VIEW, learned_marks
from throws import random_release, seen, true_throw

from diethrow.model.die import make_die
from diethrow.model.rotations import quat_from_rotvec, quat_multiply
from diethrow.model.throw.motion import Throw
from diethrow.tracking.sequence import refine_on_marks
from diethrow.tracking.sequence.refine_on_marks import with_placement_error
from diethrow.tracking.throw.measurement import measure


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


def test_frames_that_no_flight_explains_teach_no_marks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind an impact that was missed, the flight before shows each face somewhere else. 23 such frames of 103 hid the
    white numbers of a grey dodecahedron."""
    die, rng = make_die("dodecahedron", 0.007, 0.004), np.random.default_rng(7)
    throw = true_throw(die, random_release(die, rng), 0.6, impacts=2)
    track = seen(throw, rng)
    lost = track.time_s > throw.impacts[-1].time_s
    # Poses of their own, which lie on no flight.
    turned = quat_multiply(quat_from_rotvec(0.5 * rng.standard_normal((int(lost.sum()), 3))), track.quaternion[lost])
    position, quaternion = track.position_m.copy(), track.quaternion.copy()
    position[lost] += 2e-3 * rng.standard_normal((int(lost.sum()), 3))
    quaternion[lost] = turned
    found = measure(replace(track, position_m=position, quaternion=quaternion), die)
    assert found.unexplained[lost].mean() > 0.9
    learned: list[int] = []

    def learn(view: Any, images: Any, *arguments: Any, **named: Any) -> None:
        learned.extend(row for row, _ in images)

    monkeypatch.setattr(refine_on_marks, "learn_marks", learn)
    source: Any = SimpleNamespace(frame=lambda row: [np.zeros((4, 4), np.uint8)], clips=[SimpleNamespace(bit_depth=8)])
    refine_on_marks._learned(source, VIEW, found, 1.0)
    assert len(learned) > 20
    assert not found.unexplained[learned].any()


@pytest.mark.parametrize(
    ("contradiction", "variance", "gain", "useful"),
    [
        (10.0, 1.0, 0.1, True), (10.0, 1.0, -0.1, False), (19.0, 1.0, 13.0, False), (19.0, 3.8, 13.0, True),
        (19.0, 3.8, 2.0, False), (60.0, 3.8, 13.0, False),
    ],
)  # fmt: skip
def test_marks_that_contradict_edges_are_believed_where_the_edges_scatter(
    monkeypatch: pytest.MonkeyPatch, contradiction: float, variance: float, gain: float, useful: bool
) -> None:
    """Edges whose single poses err by more than they state also err in common: those of a die as grey as the table by 0.2 mm,
    with 0.03 stated, beside numbers that showed it within 0.08."""
    monkeypatch.setattr(refine_on_marks, "_learned_flights", lambda marks, throw: [])
    monkeypatch.setattr(refine_on_marks, "_contradiction", lambda both: contradiction)
    monkeypatch.setattr(refine_on_marks, "_gain", lambda *arguments: gain)
    found: Any = SimpleNamespace(throw=None, throw_without_shared_errors=None)
    marks: Any = None
    assert refine_on_marks._are_useful(marks, found, 1, variance) is useful
