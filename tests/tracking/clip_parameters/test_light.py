"""Laws of the light that faces show: it foretells how bright bevels are, and single frames err less for it."""

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
from diethrow.tracking.clip_parameters.light import normal_monomials, with_light
from diethrow.tracking.picture.kernel_types import LIGHT_TERMS
from diethrow.tracking.picture.view import View
from diethrow.tracking.pose.frame_poses import ClipPoses
from diethrow.tracking.pose.refine import refine_pose

Array = NDArray[np.float64]

ROOM = replace(studio(), noise_grey=2.0)
ROUND = replace(DICE["cube"], corner_radius_m=0.6e-3)
LEARNED, ASKED = 40, 24


def states(count: int, seed: int) -> list[State]:
    """Any orientations, in the middle of the picture."""
    rng, none = np.random.default_rng(seed), np.zeros(3)
    return [
        State(0.0, np.array([*rng.uniform(-2e-3, 2e-3, 2), 0.018]), random_quaternion(rng), none, none)
        for _ in range(count)
    ]


def at_poses(some: list[State]) -> ClipPoses:
    """The poses of a die at rest, one a frame."""
    seen = ClipPoses.empty(len(some))
    seen.known[:] = True
    seen.position_m[:], seen.rotation[:] = [s.position_m for s in some], [s.rotation for s in some]
    seen.motion[:] = 0.0
    return seen


@cache
def pictures(gloss_grey: float, count: int, seed: int) -> tuple[Image, ...]:
    """Of the rounded cube at rest in those orientations."""
    return tuple(
        photograph_rounded(ROOM, ROUND, state, np.random.default_rng([seed, k]), gloss_grey=gloss_grey)
        for k, state in enumerate(states(count, seed))
    )


def lit_view(gloss_grey: float) -> View:
    """The view with the light learned from frames that nothing else is asked of."""
    shown = pictures(gloss_grey, LEARNED, 1)
    return with_light(ROOM.view(ROUND), lambda k: shown[k][None], at_poses(states(LEARNED, 1)))


def test_the_faces_foretell_how_bright_any_surface_looks() -> None:
    light = lit_view(0.0).light[0]
    assert light[LIGHT_TERMS + 1] > 0.0
    sight = ROOM.camera.rotation[2]
    normals = np.random.default_rng(3).normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    normals = normals[normals @ sight < 0.0]  # those that a contour, at the least, shows
    true = 115.0 + 90.0 * np.maximum(normals @ LIGHT, 0.0)
    told = normal_monomials(normals) @ light[:LIGHT_TERMS]
    scale = told @ true / (told @ told)
    assert np.sqrt(np.mean((scale * told / true - 1.0) ** 2)) < 0.03


@pytest.mark.parametrize("gloss_grey", [0.0, 60.0])
def test_a_rounded_die_errs_less_where_the_light_is_known(gloss_grey: float) -> None:
    plain, light = ROOM.view(ROUND), lit_view(gloss_grey)
    at, shown = states(ASKED, 2), pictures(gloss_grey, ASKED, 2)
    aside, turned, squared = [], [], []
    for view in (plain, light):
        poses = [
            refine_pose(view, image, one.position_m, one.rotation, coarse=0)
            for image, one in zip(shown, at, strict=True)
        ]
        moved = np.array([pose.position_m - one.position_m for pose, one in zip(poses, at, strict=True)])
        wrong = np.array(
            [
                rotation_between(one.quaternion, quat_from_matrix(pose.rotation))
                for pose, one in zip(poses, at, strict=True)
            ]
        )
        aside.append(np.median(np.linalg.norm(moved @ ROOM.camera.rotation[:2].T, axis=1)))
        turned.append(np.median(np.linalg.norm(wrong, axis=1)))
        errors = np.hstack([moved, wrong])
        squared.append(np.median([e @ pose.information @ e for e, pose in zip(errors, poses, strict=True)]))
    assert aside[1] < 0.25 * aside[0]
    assert turned[1] < 0.9 * turned[0]
    # Of honest errors the median is 5.35; a highlight is no polynomial.
    assert squared[1] < (2.0 if gloss_grey == 0.0 else 3.0) * 5.35


def test_bevels_cost_a_picture_nothing() -> None:
    """A die drawn sharp reaches beyond a rounded one's corners; what lies between is not the table, nor a flat face."""
    sharp = DICE["cube"]
    costs = []
    for die, draw in ((sharp, photograph), (ROUND, photograph_rounded)):
        for k, state in enumerate(states(8, 4)):
            image = draw(ROOM, die, state, np.random.default_rng([4, k]))
            costs.append(refine_pose(ROOM.view(die), image, state.position_m, state.rotation, coarse=0).cost)
    assert np.mean(costs[8:]) < 1.1 * np.mean(costs[:8])


def told(some: list[State], paint: Array | None = None) -> Array:
    """(TERMS + 2,) what the first camera is told of the light by the cube at rest in some orientations."""
    shown = [
        photograph_rounded(ROOM, ROUND, state, np.random.default_rng([5, k]), paint=paint)
        for k, state in enumerate(some)
    ]
    return np.asarray(with_light(ROOM.view(ROUND), lambda k: shown[k][None], at_poses(some)).light[0])


def turning(turn_rad: float) -> list[State]:
    """A cube that turns evenly, by so much in all, over as many frames as the light is learned from."""
    rng, none = np.random.default_rng(6), np.zeros(3)
    first, axis = random_quaternion(rng), rng.normal(size=3)
    angles = np.linspace(0.0, turn_rad, LEARNED)[:, None] * axis / np.linalg.norm(axis)
    place = np.array([0.0, 0.0, 0.018])
    return [State(0.0, place, quat_multiply(q, first), none, none) for q in quat_from_rotvec(angles)]


def test_faces_of_several_paints_tell_little_of_the_light() -> None:
    """Their greys are no function of where they turn."""
    alike, several = (
        told(states(LEARNED, 1), np.array(paint)) for paint in ([1.0] * 6, [1.0, 0.6, 0.8, 0.5, 1.0, 0.7])
    )
    assert 0.0 < alike[-1] < 0.1 * 115.0
    assert not several.any() or several[-1] > 2.0 * alike[-1]


def test_a_die_that_hardly_turns_tells_little_of_the_light() -> None:
    plenty, little = (told(turning(turn_rad)) for turn_rad in (6.0, 1.5))
    assert 0.0 < plenty[-1] < 0.1 * 115.0
    assert not little.any() or little[-1] > 2.0 * plenty[-1]
    assert not told(turning(0.0)).any()


def test_too_few_faces_tell_nothing_of_the_light() -> None:
    assert not told(states(8, 1)).any()


def test_a_sharp_die_has_no_bevels_to_be_lit() -> None:
    view = ROOM.view(DICE["cube"])
    assert with_light(view, lambda _: pytest.fail("no picture is asked for"), at_poses(states(LEARNED, 1))) is view
