"""Laws of the light estimated on faces: it predicts how bright bevels are, and reduces the errors of single frames."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from footage_of_throws import DICE, LIGHT, Image, photograph, studio
from numpy.typing import NDArray
from random_throws import random_quaternion
from rounded_dice import photograph_rounded

from diethrow.model.rotations import quat_from_matrix, quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.throw.motion import State
from diethrow.tracking.clip_parameters.light import with_light
from diethrow.tracking.picture.view import View
from diethrow.tracking.placed_die.surface_light import LightPrior, normal_monomials
from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.pose.refine import pose_state, refine_pose

Array = NDArray[np.float64]

STUDIO = replace(studio(), noise_grey=2.0)
ROUND = replace(DICE["cube"], corner_radius_m=0.6e-3)
LEARNED, EVALUATED = 40, 24


def states(count: int, seed: int) -> list[State]:
    """Random orientations, in the middle of the picture."""
    rng, none = np.random.default_rng(seed), np.zeros(3)
    return [
        State(0.0, np.array([*rng.uniform(-2e-3, 2e-3, 2), 0.018]), random_quaternion(rng), none, none)
        for _ in range(count)
    ]


def at_poses(some: list[State]) -> ClipPoses:
    """The poses of a die at rest, one a frame."""
    poses = ClipPoses.empty(len(some))
    poses.known[:] = True
    poses.position_m[:], poses.rotation[:] = [s.position_m for s in some], [s.rotation for s in some]
    poses.motion[:] = 0.0
    return poses


@cache
def pictures(gloss_grey: float, count: int, seed: int) -> tuple[Image, ...]:
    """Pictures of the rounded cube at rest in those orientations."""
    return tuple(
        photograph_rounded(STUDIO, ROUND, state, np.random.default_rng([seed, k]), gloss_grey=gloss_grey)
        for k, state in enumerate(states(count, seed))
    )


def view_with_light(gloss_grey: float) -> View:
    """The view with the light, learned on other frames than the tests use."""
    shown = pictures(gloss_grey, LEARNED, 1)
    return with_light(STUDIO.view(ROUND), lambda k: shown[k][None], at_poses(states(LEARNED, 1)))


def test_faces_predict_the_brightness_of_any_normal() -> None:
    light = view_with_light(0.0).light
    assert light.level[0] > 0.0
    axis = STUDIO.camera.rotation[2]
    normals = np.random.default_rng(3).normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    normals = normals[normals @ axis < 0.0]  # visible ones, up to the contour
    true = 115.0 + 90.0 * np.maximum(normals @ LIGHT, 0.0)
    predicted = normal_monomials(normals) @ light.mean[0]
    scale = predicted @ true / (predicted @ predicted)
    assert np.sqrt(np.mean((scale * predicted / true - 1.0) ** 2)) < 0.03


@pytest.mark.parametrize("gloss_grey", [0.0, 60.0])
def test_known_light_reduces_the_errors_of_a_rounded_die(gloss_grey: float) -> None:
    plain, light = STUDIO.view(ROUND), view_with_light(gloss_grey)
    at, shown = states(EVALUATED, 2), pictures(gloss_grey, EVALUATED, 2)
    aside, turned, squared = [], [], []
    for view in (plain, light):
        poses = [
            refine_pose(view, image, pose_state(one.position_m, one.rotation), coarse=0, edges_alone=True)
            for image, one in zip(shown, at, strict=True)
        ]
        moved = np.array([pose.position_m - one.position_m for pose, one in zip(poses, at, strict=True)])
        wrong = np.array(
            [
                rotation_between(one.quaternion, quat_from_matrix(pose.rotation))
                for pose, one in zip(poses, at, strict=True)
            ]
        )
        aside.append(np.median(np.linalg.norm(moved @ STUDIO.camera.rotation[:2].T, axis=1)))
        turned.append(np.median(np.linalg.norm(wrong, axis=1)))
        errors = np.hstack([moved, wrong])
        squared.append(np.median([e @ pose.information @ e for e, pose in zip(errors, poses, strict=True)]))
    assert aside[1] < 0.4 * aside[0]
    assert turned[1] < (1.0 if gloss_grey == 0.0 else 1.1) * turned[0]
    # The median of chi-square is 5.35; a highlight is no polynomial.
    assert squared[1] < (2.0 if gloss_grey == 0.0 else 3.0) * 5.35


def test_bevels_do_not_raise_the_cost_of_a_picture() -> None:
    """A sharp outline reaches beyond rounded corners; the pixels between show neither the table nor a flat face."""
    sharp = DICE["cube"]
    costs = []
    for die, draw in ((sharp, photograph), (ROUND, photograph_rounded)):
        for k, state in enumerate(states(8, 4)):
            image = draw(STUDIO, die, state, np.random.default_rng([4, k]))
            costs.append(
                refine_pose(STUDIO.view(die), image, pose_state(state.position_m, state.rotation), coarse=0).cost
            )
    assert np.mean(costs[8:]) < 1.1 * np.mean(costs[:8])


def estimated(some: list[State], paint: Array | None = None) -> LightPrior:
    """The light estimated on the cube at rest in some orientations."""
    shown = [
        photograph_rounded(STUDIO, ROUND, state, np.random.default_rng([5, k]), paint=paint)
        for k, state in enumerate(some)
    ]
    return with_light(STUDIO.view(ROUND), lambda k: shown[k][None], at_poses(some)).light


def turning(turn_rad: float) -> list[State]:
    """A cube that turns evenly, by `turn_rad` in all, over LEARNED frames."""
    rng, none = np.random.default_rng(6), np.zeros(3)
    first, axis = random_quaternion(rng), rng.normal(size=3)
    angles = np.linspace(0.0, turn_rad, LEARNED)[:, None] * axis / np.linalg.norm(axis)
    place = np.array([0.0, 0.0, 0.018])
    return [State(0.0, place, quat_multiply(q, first), none, none) for q in quat_from_rotvec(angles)]


def test_faces_of_several_paints_make_the_light_uncertain() -> None:
    """Their greys are no function of the normal."""
    one_paint, several_paints = (
        estimated(states(LEARNED, 1), np.array(paint)).deviation[0]
        for paint in ([1.0] * 6, [1.0, 0.6, 0.8, 0.5, 1.0, 0.7])
    )
    assert 0.0 < one_paint < 0.1 * 115.0
    assert several_paints == 0.0 or several_paints > 2.0 * one_paint


def test_a_die_that_hardly_turns_makes_the_light_uncertain() -> None:
    plenty, little = (estimated(turning(turn_rad)).deviation[0] for turn_rad in (6.0, 1.5))
    assert 0.0 < plenty < 0.1 * 115.0
    assert little == 0.0 or little > 2.0 * plenty
    assert not estimated(turning(0.0)).level.any()


def test_too_few_faces_give_no_light() -> None:
    assert not estimated(states(8, 1)).level.any()


def test_a_sharp_die_needs_no_light() -> None:
    view = STUDIO.view(DICE["cube"])
    assert with_light(view, lambda _: pytest.fail("a picture was read"), at_poses(states(LEARNED, 1))) is view
