"""A throw filmed with a display curve, tracked in light, is as accurate as with a linear camera."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, falling_cube, film, studio
from numpy.typing import NDArray
from replay_records import ArrayClip

from diethrow.model.rotations import quat_conjugate, quat_from_matrix, quat_multiply, rotation_between
from diethrow.tracking.footage.response import Response, clip_in_light, grey_of, level_grey, picture_in_light
from diethrow.tracking.sequence.tracker import ClipFacts, track_clip

Array = NDArray[np.float64]

FRAMES = 40
FILMS = 12
"""Whose errors are compared: the ratio of two errors of one film scatters by a fifth."""
SPIN_RAD_S = 80.0
"""Of each component: the frames show more than one side of the die."""
BITS = 12
"""Of the linear film, which the curve turns into 8 bits."""
LARGEST = 2.0**BITS - 1.0
CUBE = DICE["cube"]
ROOM = replace(studio(), noise_grey=1.0)


def encoded(light: Array, response: Response) -> Array:
    """Grey levels of 8 bits, not rounded."""
    return 255.0 * grey_of(np.asarray(light, float) / LARGEST, response)


@cache
def depth_and_nees(filmed: Response, given: Response, *, estimated: bool = False, seed: int = 1) -> tuple[float, float]:
    """Median error [m] along the line of sight, and median squared distance from the truth in standard errors."""
    throw = falling_cube(FRAMES / FPS, spin_rad_s=SPIN_RAD_S)
    linear = film(ROOM, CUBE, throw, FRAMES, bit_depth=BITS, seed=seed)
    clip = ArrayClip(np.rint(encoded(linear.array, filmed)).astype(np.uint8), linear.times_s)
    table = np.rint(encoded(2.0 ** (BITS - 8) * ROOM.table, filmed)).astype(np.float32)
    track = track_clip(
        clip_in_light(clip, given),
        ROOM.camera,
        CUBE,
        background=picture_in_light(table, clip, given),
        facts=ClipFacts(level_grey=level_grey(clip, given), estimates_response=estimated),
    ).track
    assert track.tracked.all()
    positions, quaternions = throw.poses(track.time_s)
    alike = quat_multiply(quaternions[0], quat_from_matrix(ROOM.view(CUBE).symmetries))
    chosen = alike[int(np.argmax(np.abs(alike @ track.quaternion[0])))]
    relabelled = quat_multiply(quaternions, quat_multiply(quat_conjugate(quaternions[0]), chosen))
    moved = positions - track.position_m
    errors = np.concatenate([moved, rotation_between(track.quaternion, relabelled)], axis=1)
    nees = [e @ np.linalg.solve(C, e) for e, C in zip(errors, track.covariance, strict=True)]
    return float(np.median(np.abs(moved @ ROOM.camera.rotation[2]))), float(np.median(nees))


def mean_over_films(filmed: Response, given: Response) -> Array:
    """(2,) means of `depth_and_nees` over films with noise of their own: frames of one film share most of their error."""
    return np.asarray(np.mean([depth_and_nees(filmed, given, seed=seed) for seed in range(1, FILMS + 1)], axis=0))


@pytest.mark.parametrize("response", ["srgb", 0.45])
def test_a_display_curve_that_is_given_costs_no_accuracy(response: Response) -> None:
    linear_m, linear_nees = mean_over_films("linear", None)
    depth_m, nees = mean_over_films(response, response)
    # The curves resolve bright light in steps of two linear levels of 8 bits, which raises its noise by a seventh.
    assert depth_m < 1.2 * linear_m
    assert nees < 1.5 * linear_nees


@pytest.mark.parametrize("response", ["srgb", 0.45])
def test_a_display_curve_that_is_not_given_is_estimated(response: Response) -> None:
    # From 1.0 mm off to less than a third of that, and the covariance knows what the exponent leaves open.
    depth_m, nees = depth_and_nees(response, None, estimated=True)
    assert depth_m < 0.3 * depth_and_nees(response, None)[0]
    assert nees < 12.0


def test_an_estimate_changes_nothing_of_a_linear_clip_but_its_covariance() -> None:
    depth_m, nees = depth_and_nees("linear", None, estimated=True)
    linear_m, linear_nees = depth_and_nees("linear", None)
    assert depth_m < 1.2 * linear_m
    assert nees < 1.2 * linear_nees


def test_an_unknown_display_curve_moves_the_die_in_depth() -> None:
    # By 0.99 mm, 71 times as far as in light.
    assert depth_and_nees(0.45, None)[0] > 20.0 * depth_and_nees(0.45, 0.45)[0]
