"""Laws of the response estimated from a clip: a display curve is found with the stated error, and none where there is none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from footage_of_throws import DICE, photograph, studio
from numpy.typing import NDArray
from random_throws import random_quaternion
from replay_records import ArrayClip
from rounded_dice import photograph_rounded

from diethrow.model.die import Die
from diethrow.model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, rotation_between
from diethrow.model.throw import State
from diethrow.tracking.clip_parameters.response import (
    FEWEST_FRAMES,
    UNKNOWN_SIGMA,
    EstimatedResponse,
    estimate_response,
)
from diethrow.tracking.footage.response import Response, grey_of
from diethrow.tracking.picture.view import View
from diethrow.tracking.pose.clip_poses import SampledFrames
from diethrow.tracking.pose.refine import pose_state, refine_pose

Array = NDArray[np.float64]

ROOM = replace(studio(), noise_grey=1.0)
FRAMES = 24
WELL_ROUNDED = replace(DICE["cube"], corner_radius_m=2.4e-3)


def die_of(name: str) -> Die:
    return WELL_ROUNDED if name == "well rounded" else DICE[name]


class Dice(NamedTuple):
    """Dice at rest."""

    count: int = FRAMES
    sides: int | None = None
    """They show so many, which follow each other; None if each is turned at random."""
    seed: int = 3


AT_RANDOM = Dice()


def states(dice: Dice) -> list[State]:
    rng, none = np.random.default_rng(dice.seed), np.zeros(3)
    drawn = [
        State(0.0, np.array([*rng.uniform(-2e-3, 2e-3, 2), 0.018]), random_quaternion(rng), none, none)
        for _ in range(dice.count)
    ]
    sides = dice.sides or dice.count
    return [replace(state, quaternion=drawn[k * sides // dice.count].quaternion) for k, state in enumerate(drawn)]


@cache
def light(name: str, dice: Dice) -> Array:
    """(count, height, width) light of dice at rest, in levels of 8 bits, not rounded."""
    shoot = photograph_rounded if name == "well rounded" else photograph
    shown = enumerate(states(dice))
    return np.array([shoot(ROOM, die_of(name), state, np.random.default_rng([3, k])) for k, state in shown], float)


def found(
    name: str, response: Response, dice: Dice = AT_RANDOM, off_m: float = 0.0, of_clip: type[ArrayClip] = ArrayClip
) -> EstimatedResponse | None:
    """The response of a clip of resting dice, from poses that are off by some distance and a tenth of a degree."""
    grey = 255.0 * grey_of(np.clip(light(name, dice) / 255.0, 0.0, 1.0), response)
    pictures, count = np.rint(grey).astype(np.uint8), dice.count
    clip = of_clip(pictures, np.arange(count) / 1000.0)
    table = np.rint(255.0 * grey_of(ROOM.table / 255.0, response)).astype(np.float32)
    view: View = replace(ROOM, table=table).view(die_of(name))
    rng = np.random.default_rng(5)
    turn = matrix_from_quat(quat_from_rotvec(np.radians(0.1) * rng.normal(size=(count, 3))))
    positions = np.array([state.position_m for state in states(dice)]) + off_m * rng.normal(size=(count, 3))
    rotations = turn @ matrix_from_quat(np.array([state.quaternion for state in states(dice)]))

    def looks(most: int) -> SampledFrames:
        rows = np.arange(count)
        return SampledFrames.at(rows, lambda k: pictures[k][None], positions, rotations, np.zeros((count, 6)), most)

    return estimate_response(view, looks, clip)


@pytest.mark.parametrize("exponent", [0.45, 0.6])
@pytest.mark.parametrize("name", ["cube", "icosahedron", "well rounded"])
def test_a_display_curve_is_found_within_its_error(name: str, exponent: float) -> None:
    response = found(name, exponent, off_m=2e-4)
    assert response is not None
    assert not response.is_linear
    assert abs(response.exponent - exponent) < 3.0 * response.sigma
    assert response.sigma < 0.15
    assert f"{response.exponent:.2f}" in response.notice


@pytest.mark.parametrize("name", ["cube", "tetrahedron", "octahedron", "dodecahedron", "icosahedron", "well rounded"])
def test_a_linear_clip_is_left_as_it_is(name: str) -> None:
    response = found(name, "linear", off_m=2e-4)
    assert response is not None
    assert response.is_linear
    assert response.sigma <= UNKNOWN_SIGMA


@pytest.mark.parametrize("seed", [15, 17, 19])
def test_a_slight_curve_that_imitates_the_light_is_not_undone(seed: int) -> None:
    """A terminator on a well-rounded die makes an exponent of 0.84 to 0.9 look better than 1, on one of these for certain."""
    response = found("well rounded", "linear", Dice(seed=seed), off_m=2e-4)
    assert response is not None
    assert response.is_linear
    assert response.sigma > 0.0


def test_the_srgb_curve_is_about_that_of_its_best_exponent() -> None:
    response = found("cube", "srgb")
    assert response is not None
    assert 0.4 < response.exponent < 0.6


@pytest.mark.parametrize("name", ["cube", "icosahedron", "well rounded"])
def test_the_column_of_the_response_is_what_a_curve_does_to_a_pose(name: str) -> None:
    """A slight curve of the grey levels moves the pose as its bias Jacobian says."""
    step, moved, expected = 0.05, [], []
    room = replace(ROOM, noise_grey=0.5)
    view = replace(room.view(die_of(name)), response_sigma=UNKNOWN_SIGMA)
    for state in states(Dice(6)):
        shoot = photograph_rounded if name == "well rounded" else photograph
        linear = np.asarray(shoot(room, die_of(name), state), np.float32)
        poses = []
        for exponent in (1.0, 1.0 - step):
            picture, table = (np.asarray(255.0 * (one / 255.0) ** exponent, np.float32) for one in (linear, room.table))
            curved = replace(view, backgrounds=np.ascontiguousarray(table[None]))
            start = pose_state(state.position_m, matrix_from_quat(state.quaternion))
            poses.append(refine_pose(curved, picture, start, coarse=0))
        first, other = poses
        turn = rotation_between(quat_from_matrix(first.rotation), quat_from_matrix(other.rotation))
        change = np.concatenate([other.position_m - first.position_m, turn])
        # In standard errors of the picture, in which all six count alike.
        root = np.linalg.cholesky(first.information).T
        moved.append(root @ change)
        expected.append(root @ first.bias_jacobian[:, 1] * -step)
    moved, expected = np.concatenate(moved), np.concatenate(expected)
    assert np.linalg.norm(moved - expected) < 0.5 * np.linalg.norm(moved)


def test_a_lossy_codec_leaves_a_linear_response_unknown() -> None:
    class Compressed(ArrayClip):
        def metadata(self) -> dict[str, Any]:
            return super().metadata() | {"codec": "h264"}

    response = found("cube", "linear", of_clip=Compressed)
    assert response is not None
    assert response == EstimatedResponse(1.0, UNKNOWN_SIGMA)
    assert not response.is_exact
    assert f"{UNKNOWN_SIGMA:.2f}" in response.notice
    assert EstimatedResponse(1.0, 0.0).is_exact


@pytest.mark.parametrize("sides", [2, 3])
@pytest.mark.parametrize("name", ["cube", "dodecahedron"])
def test_few_sides_of_a_die_hide_no_curve(name: str, sides: int) -> None:
    """A clip without loss counts as linear only where nothing speaks for a curve."""
    curved, linear = found(name, 0.5, Dice(sides=sides)), found(name, "linear", Dice(sides=sides))
    assert curved is not None
    assert linear is not None
    assert curved.sigma >= 0.1
    assert curved.is_linear or abs(curved.exponent - 0.5) < 3.0 * curved.sigma
    assert linear.is_linear


def test_too_few_frames_say_nothing() -> None:
    assert found("cube", 0.45, Dice(FEWEST_FRAMES - 1)) is None
