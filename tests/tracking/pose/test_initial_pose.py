"""Laws of the first pose: found with no click, and not found where no die is."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import patch

import cv2
import footage_of_throws
import numpy as np
import pytest
from footage_of_throws import DICE, REACH_M, photograph, studio
from random_throws import random_quaternion

from diethrow.model.die.die import Die
from diethrow.model.die.solid import SHAPES
from diethrow.model.die.symmetry import nearest_equivalent_rotation
from diethrow.model.rotations import quat_from_matrix, quat_from_rotvec, rotvec_from_quat
from diethrow.model.throw.motion import State
from diethrow.tracking.picture.pose_costs import mirror_region_costs
from diethrow.tracking.picture.segmentation import (
    DITHERED,
    Blob,
    background_noise,
    differing,
    errs_alike,
    largest_blob,
    level_step,
    without_rims,
    without_shadow,
)
from diethrow.tracking.picture.view import make_view
from diethrow.tracking.pose.initial_pose import DISTANCE_FACTORS, _trials, die_blobs, initial_poses

ROOM = replace(studio(), noise_grey=2.0, shadow=0.4)


def state_at(rng: np.random.Generator, height_m: float = 0.018) -> State:
    return State(0.0, np.array([0.001, -0.002, height_m]), random_quaternion(rng), np.zeros(3), np.zeros(3))


@pytest.mark.parametrize("shape", SHAPES)
def test_the_first_pose_is_found_up_to_the_symmetry_of_the_die(shape: str) -> None:
    rng = np.random.default_rng(52)
    state, view = state_at(rng), ROOM.view(DICE[shape])
    found = initial_poses(view, photograph(ROOM, DICE[shape], state, rng))
    scores = [score for score, _ in found]
    assert scores == sorted(scores)
    # Not always the best of one frame, but among those that a few frames will tell apart. A tenth of a degree is what
    # the pixels hold; the cone of attraction ends at about ten degrees.
    off = []
    for _, pose in found:
        alike = nearest_equivalent_rotation(pose.rotation, state.rotation, view.symmetries)
        off.append(np.degrees(np.linalg.norm(rotvec_from_quat(quat_from_matrix(alike @ state.rotation.T)))))
    best = int(np.argmin(off))
    assert off[best] < 0.5
    # Depth is the worst known: a fifth of a pixel in 80 is a 400th of 40 cm.
    assert np.linalg.norm(found[best][1].position_m - state.position_m) < 0.1 * REACH_M


def test_an_empty_table_shows_no_die() -> None:
    image = photograph(ROOM, DICE["cube"], None, np.random.default_rng(1))
    assert initial_poses(ROOM.view(DICE["cube"]), image) == []


def shadow_alone(share: float, rim_px: float, seed: int = 4) -> np.ndarray:
    """The table with a soft shadow in the middle and nothing that casts it."""
    x = np.arange(ROOM.camera.width_px)
    away = np.hypot(x[None, :] - 110.0, x[:, None] - 90.0)
    light = 1.0 - share / (1.0 + np.exp((away - 30.0) / rim_px))
    noise = np.random.default_rng(seed).normal(scale=ROOM.noise_grey, size=away.shape)
    return np.asarray(ROOM.table * light + noise, np.float32)


# On this table, where the texture is three times the noise, a dark shadow with a hard rim is not told from a die by one
# frame.
@pytest.mark.parametrize(("share", "rim_px"), [(0.2, 2.0), (0.2, 4.0), (0.2, 6.0), (0.4, 6.0)])
def test_a_soft_shadow_alone_is_no_die(share: float, rim_px: float) -> None:
    view, image = ROOM.view(DICE["cube"]), shadow_alone(share, rim_px)
    assert largest_blob(differing(image, view.background, view.noise_grey)) is not None
    assert die_blobs(view, image) == []
    assert initial_poses(view, image) == []


@pytest.mark.parametrize("shape", SHAPES)
def test_the_shadow_is_told_from_the_die(shape: str) -> None:
    rng = np.random.default_rng(20)
    state, view = state_at(rng, 0.022), ROOM.view(DICE[shape])
    image = photograph(ROOM, DICE[shape], state, rng)
    mask = differing(image, view.background, view.noise_grey)
    lit = without_shadow(image, view.background, view.noise_grey, mask)
    bare = photograph(replace(ROOM, shadow=0.0), DICE[shape], state)
    die = np.abs(bare - ROOM.table) > 8.0
    assert lit[die].mean() > 0.85
    # A window of 9 pixels that reaches the die or the soft rim of the shadow sees no constant share of light: the heart
    # of the shadow lies further from both.
    heart = cv2.erode((mask & ~die).astype(np.uint8), np.ones((15, 15), np.uint8)).astype(bool)
    assert heart.sum() > 50
    assert lit[heart].mean() < 0.05


@pytest.mark.parametrize("shape", SHAPES)
def test_the_bulk_of_what_is_no_shadow_is_the_die(shape: str) -> None:
    """Also where the shadow begins at the die, and leaves a ring about itself that no window tells from it."""
    die = DICE[shape]
    for seed in range(4):
        rng = np.random.default_rng([21, seed])
        state = state_at(rng, 0.012)
        image, view = photograph(ROOM, die, state, rng), ROOM.view(die)
        mask = differing(image, view.background, view.noise_grey)
        lit = without_shadow(image, view.background, view.noise_grey, mask)
        blob = largest_blob(without_rims(image, view.background, mask, lit), holes_px=1)
        assert blob is not None
        outer = ROOM.camera.project(die.solid.vertices @ state.rotation.T + state.position_m).astype(np.float32)
        true = cv2.moments(cv2.convexHull(outer))
        middle = np.array([true["m10"], true["m01"]]) / true["m00"]
        # Of a die 80 px across a tenth of its size is within what the edges pull in, and an eighth of its distance.
        assert np.linalg.norm(blob.centre_px - middle) < 0.1 * np.sqrt(true["m00"])
        assert blob.area_px == pytest.approx(true["m00"], rel=0.25)


def test_trials_are_as_large_as_the_region_that_they_are_to_explain() -> None:
    for die in DICE.values():
        view = ROOM.view(die)
        blob = Blob(np.array([110.0, 90.0]), 3600.0, (80, 60, 140, 120), False)
        places, rotations = _trials(view, blob)
        areas, middles = [], []
        for place, rotation in zip(places[::37], rotations[::37], strict=True):
            outline = cv2.convexHull(view.camera.project(die.solid.vertices @ rotation.T + place).astype(np.float32))
            moments = cv2.moments(outline)
            areas.append(moments["m00"])
            middles.append([moments["m10"] / moments["m00"], moments["m01"] / moments["m00"]])
        # Three distances; perspective and the lens make single ones up to a twentieth smaller or larger.
        factors = np.sort(np.sqrt(3600.0 / np.array(areas)))
        assert np.abs(factors[:, None] - DISTANCE_FACTORS).min(1).max() < 0.05
        assert np.linalg.norm(np.array(middles) - blob.centre_px, axis=1).max() < 2.0


def dark_but_above(die: Die, rotation: np.ndarray) -> np.ndarray:
    """Greys of faces of which the upper one alone is bright, and the others are darker than the table."""
    up = die.solid.normals @ rotation[2]
    return np.where(up == up.max(), 190.0, 45.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_dark_face_before_a_mirror_is_no_shadow(seed: int) -> None:
    """A smaller cube further away covers the bright face alone: a shadow might explain the rest, on a mirror none can."""
    rng = np.random.default_rng([8, seed])
    quaternion = quat_from_rotvec(np.array([0.15, -0.1, 0.3]) + 0.1 * rng.normal(size=3))
    state = State(0.0, np.array([0.001, -0.002, 0.024]), quaternion, np.zeros(3), np.zeros(3))
    smooth = replace(ROOM, table=np.full_like(ROOM.table, 80.0), shadow=0.0)
    with patch.object(footage_of_throws, "greys", dark_but_above):
        image = photograph(smooth, DICE["cube"], state, rng)
    view = make_view(smooth.camera, DICE["cube"], smooth.table, 2.0, None, smooth.blur_px, mirror=True)
    found = initial_poses(view, image)
    alike = nearest_equivalent_rotation(found[0][1].rotation, state.rotation, view.symmetries)
    assert np.degrees(np.linalg.norm(rotvec_from_quat(quat_from_matrix(alike @ state.rotation.T)))) < 0.5
    assert np.linalg.norm(found[0][1].position_m - state.position_m) < 0.1 * REACH_M
    box = (20, 20, 180, 180)
    further = state.position_m + 0.15 * (state.position_m - view.camera.centre_m)
    both = np.array([state.position_m, further]), np.array([state.rotation, state.rotation])
    right, wrong = mirror_region_costs(view, image, box, *both, 6000)
    # What is left of the right one is the blurred rim of the dark faces.
    assert 0.0 <= right < 0.2 * wrong


def test_a_die_cut_by_the_border_is_no_start() -> None:
    rng = np.random.default_rng(3)
    right = ROOM.camera.rotation[0]
    state = state_at(rng)
    state = replace(state, position_m=state.position_m + 0.0265 * right)
    assert die_blobs(ROOM.view(DICE["cube"]), photograph(replace(ROOM, shadow=0.0), DICE["cube"], state, rng)) == []


def test_the_noise_of_the_still_table_is_measured_past_the_die() -> None:
    rng = np.random.default_rng(5)
    images = [photograph(ROOM, DICE["cube"], state_at(rng), rng) for _ in range(4)]
    # The median of forty thousand pixels has an error of a per cent; a fifth of them, under the die, only raise it.
    assert background_noise(images, ROOM.table) == pytest.approx(2.0, rel=0.25)
    assert background_noise([ROOM.table], ROOM.table) == 0.3


def test_the_step_between_grey_levels_is_that_of_the_rounding() -> None:
    rng = np.random.default_rng(5)
    images = [np.rint(photograph(ROOM, DICE["cube"], state_at(rng), rng)) for _ in range(2)]
    assert level_step(images) == 1.0
    assert level_step([np.floor(image / 16.0) * 16.0 for image in images]) == 16.0
    # Levels stretched to the full scale lie 36 or 37 apart.
    assert level_step([np.rint(np.floor(image / 32.0) * 255.0 / 7.0) for image in images]) == 36.0
    assert level_step([np.zeros((20, 20), np.float32)]) == 1.0
    table = [np.floor(ROOM.table / 16.0) * 16.0]
    # Rounding errors are uniform over a step, whose standard deviation is 0.29.
    assert background_noise(table, table[0], 16.0) == pytest.approx(16.0 / np.sqrt(12.0), rel=0.05)


def test_only_rounding_wider_than_the_noise_errs_alike() -> None:
    assert errs_alike(16.0, 2.0)
    assert not errs_alike(1.0, 0.3)
    assert not errs_alike(16.0, 16.0 * DITHERED)
    # Of many pixels of one grey the mean is off by no more than a four hundredth of a step where noise is half as wide.
    rng = np.random.default_rng(1)
    greys = np.linspace(0.0, 1.0, 21)
    means = np.array([np.floor(grey + DITHERED * rng.normal(size=200_000) + 0.5).mean() for grey in greys])
    assert np.abs(means - greys).max() < 1.0 / 400.0 + 4.0 * np.sqrt(DITHERED**2 + 1.0 / 12.0) / np.sqrt(200_000)


def test_the_largest_region_is_reported_with_its_place() -> None:
    mask = np.zeros((60, 80), bool)
    mask[20:40, 30:55] = True
    mask[5:9, 5:9] = True
    blob = largest_blob(mask)
    assert blob is not None
    np.testing.assert_allclose(blob.centre_px, (42.0, 29.5), atol=1e-9)
    assert (blob.area_px, blob.box, blob.touches_border) == (500.0, (30, 20, 55, 40), False)
    mask[20:40, 30:] = True
    cut = largest_blob(mask)
    assert cut is not None
    assert cut.touches_border
    assert largest_blob(np.zeros((60, 80), bool)) is None
