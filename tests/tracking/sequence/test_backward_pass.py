"""Laws of the backward pass: its poses replace wrong ones behind an impact, by the sequence of least cost through both."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from cube_seen_late import off_m, whole_track
from footage_of_throws import FPS
from numpy.typing import NDArray

from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.sequence.backward_pass import (
    CHANGE_COST,
    LOST_EXCESS_COST,
    _prefers_backward,
    with_backward_poses,
)

Array = NDArray[np.float64]


def test_backward_poses_replace_wrong_ones_behind_an_impact() -> None:
    view, task, poses, throw = whole_track()
    assert with_backward_poses(view, task, poses) is poses
    (first, second) = (int(np.ceil(bounce.time_s * FPS)) for bounce in throw.bounces)
    wrong = poses.copy()
    wrong.begins[[first, second]] = True
    wrong.position_m[first:second] += np.array([3e-3, 0.0, 0.0])
    wrong.cost[first:second] += 0.5
    again = with_backward_poses(view, task, wrong)
    assert off_m(wrong, throw)[first:second].min() > 2e-3
    assert off_m(again, throw).max() < 1e-3
    assert np.array_equal(again.position_m[second + 1 :], poses.position_m[second + 1 :])
    assert np.abs(np.flatnonzero(again.begins)[:, None] - [first, second]).min(axis=1).max() <= 1


@pytest.mark.parametrize("seed", range(20))
def test_the_sequence_of_least_cost_through_two_tracks_is_the_best_of_all(seed: int) -> None:
    rng, n = np.random.default_rng(seed), 8
    tracks = ClipPoses.empty(n), ClipPoses.empty(n)
    for track in tracks:
        track.known[:], track.cost[:] = rng.random(n) < 0.8, rng.uniform(2.0, 3.0, n)
    apart, lost = rng.random(n) < 0.7, float(np.median(tracks[0].cost[tracks[0].known])) + LOST_EXCESS_COST
    costs = np.stack([np.where(track.known, track.cost, lost) for track in tracks])
    changes = CHANGE_COST * (apart[1:] & apart[:-1])

    def cost(path: Array) -> float:
        return float(costs[path, np.arange(n)].sum() + changes[path[1:] != path[:-1]].sum())

    best = min(cost(np.array(path)) for path in itertools.product((0, 1), repeat=n))
    assert cost(_prefers_backward(*tracks, apart).astype(int)) == pytest.approx(best, abs=1e-12)
