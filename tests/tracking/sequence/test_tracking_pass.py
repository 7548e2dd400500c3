"""Laws of the tracking pass: a rounded die is tracked again with the light of its faces, and a sharp one pays nothing for it.

How much the light improves single pictures is a law of `clip_parameters/test_light.py`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, falling_cube, film, studio

import diethrow.tracking.sequence.tracking_pass as tracking_pass
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.picture.view import View
from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.sequence.tracking_pass import TrackingTask, track_once

STUDIO = replace(studio(), noise_grey=2.0)
ROUND = replace(DICE["cube"], corner_radius_m=0.1 * DICE["cube"].solid.edge_m)
FRAMES, FPS = 40, 1500.0


def task() -> TrackingTask:
    clip = film(STUDIO, DICE["cube"], falling_cube(FRAMES / FPS), FRAMES)
    return TrackingTask(FrameSource([clip]), np.zeros(FRAMES, bool), None, lambda done: None)


def poses_on(frames: int, cost: float) -> ClipPoses:
    poses = ClipPoses.empty(FRAMES)
    poses.known[:frames], poses.cost[:frames] = True, cost
    poses.position_m[:frames], poses.rotation[:frames], poses.motion[:frames] = 0.0, np.eye(3), 0.0
    return poses


@pytest.mark.parametrize(
    ("frames", "cost", "taken"),
    [(40, 3.0, True), (40, 2.5, True), (40, 3.2, False), (30, 2.5, False)],
    ids=["as good", "better", "fits worse", "covers less"],
)
def test_the_pass_with_light_is_taken_unless_it_covers_or_fits_less(
    frames: int, cost: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = STUDIO.view(ROUND)
    lit_view = replace(view, light=np.ones_like(view.light))
    unlit, lit = poses_on(40, 3.0), poses_on(frames, cost)
    monkeypatch.setattr(tracking_pass, "with_light", lambda view, picture, poses: lit_view)
    monkeypatch.setattr(
        tracking_pass,
        "_tracked_from_initial_pose",
        lambda view, task: (view, lit if view.light.any() else unlit),
    )
    found, poses = track_once(view, task())
    assert poses is (lit if taken else unlit)
    assert found.light.any() == taken


def test_a_sharp_die_is_tracked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    passes = []
    once = tracking_pass._tracked_from_initial_pose

    def counted(view: View, task: TrackingTask) -> tuple[View, ClipPoses]:
        passes.append(view.die.corner_radius_m)
        return once(view, task)

    monkeypatch.setattr(tracking_pass, "_tracked_from_initial_pose", counted)
    view, _ = track_once(STUDIO.view(DICE["cube"]), task())
    assert passes == [0.0]
    assert not view.light.any()
