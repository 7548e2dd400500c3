"""Laws of the tracking pass: the light of its faces serves a rounded die, and costs a sharp one nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from footage_of_throws import DICE, studio
from numpy.typing import NDArray
from replay_records import ArrayClip
from rounded_dice import photograph_rounded

import diethrow.tracking.sequence.tracking_pass as tracking_pass
from diethrow.model.die.die import Die
from diethrow.model.throw.motion import Flight, State
from diethrow.tracking.clip_parameters.corner_radius import CornerRounding
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.picture.view import View
from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.sequence.tracking_pass import TrackingTask, track_rounded

Array = NDArray[np.float64]

STUDIO = replace(studio(), noise_grey=2.0)
EDGE_M = DICE["cube"].solid.edge_m
ROUND = replace(DICE["cube"], corner_radius_m=0.1 * EDGE_M)
FRAMES, FPS = 40, 1500.0
FALL = Flight(
    State(
        0.0,
        np.array([-0.002, 0.0, 0.03]),
        np.array([0.8, 0.2, 0.5, 0.26]),
        np.array([0.05, 0.05, -0.3]),
        np.array([60.0, 80.0, 40.0]),
    ),
    np.inf,
)
"""A die that turns by nearly half a turn as it falls: its faces have seen the light from many sides."""


@cache
def clip() -> ArrayClip:
    """A cube with corners rounded by a tenth of its edge, while it falls."""
    times = np.arange(FRAMES) / FPS
    pictures = [
        photograph_rounded(STUDIO, ROUND, FALL.at(float(t)), np.random.default_rng([1, k])) for k, t in enumerate(times)
    ]
    return ArrayClip(np.clip(np.rint(pictures), 0, 255).astype(np.uint8), times, 8)


def tracked(die: Die) -> tuple[View, ClipPoses]:
    source = FrameSource([clip()])
    task = TrackingTask(source, np.zeros(len(source), bool), None, lambda done: None)
    view, poses, _ = track_rounded(STUDIO.view(die), task, CornerRounding.GIVEN)
    return view, poses


def test_a_rounded_die_is_tracked_again_with_the_light_of_its_faces(monkeypatch: pytest.MonkeyPatch) -> None:
    # How much the light improves single pictures is a law of `clip_parameters/test_light.py`.
    view, lit = tracked(ROUND)
    monkeypatch.setattr(tracking_pass, "LIGHT_PASSES", 0)
    once, unlit = tracked(ROUND)
    assert not once.light.any()
    assert view.light.any()
    assert lit.frames >= tracking_pass.SUFFICIENT_FRAMES * unlit.frames


def test_a_sharp_die_is_tracked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    passes = []
    once = tracking_pass._tracked_from_initial_pose

    def counted(view: View, task: TrackingTask) -> tuple[View, ClipPoses]:
        passes.append(view.die.corner_radius_m)
        return once(view, task)

    monkeypatch.setattr(tracking_pass, "_tracked_from_initial_pose", counted)
    view, _ = tracked(DICE["cube"])
    assert passes == [0.0]
    assert not view.light.any()
