"""Laws of segmentation: the die is distinguished from its shadow, and noise is measured on the still table."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from footage_of_throws import DICE, photograph, still, studio

from diethrow.model.die.solid import SHAPES
from diethrow.tracking.picture.segmentation import (
    DITHERED,
    background_noise,
    differs_clearly,
    differs_from_background,
    largest_blob,
    level_step,
    noise_beside_die,
    pixel_noise,
    rounding_is_correlated,
    without_rims,
    without_shadow,
)

ROOM = replace(studio(), noise_grey=2.0, shadow=0.4)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_shadow_is_distinguished_from_the_die(shape: str) -> None:
    rng = np.random.default_rng(20)
    state, view = still(rng, 0.022), ROOM.view(DICE[shape])
    image = photograph(ROOM, DICE[shape], state, rng)
    mask = differs_from_background(image, view.background, view.noise_grey)
    lit = without_shadow(image, view.background, view.noise_grey, mask)
    bare = photograph(replace(ROOM, shadow=0.0), DICE[shape], state)
    die = np.abs(bare - ROOM.table) > 8.0
    assert lit[die].mean() > 0.85
    # A window of 9 pixels that reaches the die or the soft rim of the shadow has no constant share of light: the heart of
    # the shadow lies farther from both.
    heart = cv2.erode((mask & ~die).astype(np.uint8), np.ones((15, 15), np.uint8)).astype(bool)
    assert heart.sum() > 50
    assert lit[heart].mean() < 0.05


@pytest.mark.parametrize("shape", SHAPES)
def test_the_bulky_part_without_shadow_is_the_die(shape: str) -> None:
    """The shadow may begin at the die, and leave a ring about itself that no window distinguishes from it."""
    die = DICE[shape]
    for seed in range(4):
        rng = np.random.default_rng([21, seed])
        state = still(rng, 0.012)
        image, view = photograph(ROOM, die, state, rng), ROOM.view(die)
        mask = differs_from_background(image, view.background, view.noise_grey)
        lit = without_shadow(image, view.background, view.noise_grey, mask)
        blob = largest_blob(without_rims(image, view.background, mask, lit), holes_px=1)
        assert blob is not None
        outer = ROOM.camera.project(die.solid.vertices @ state.rotation.T + state.position_m).astype(np.float32)
        true = cv2.moments(cv2.convexHull(outer))
        middle = np.array([true["m10"], true["m01"]]) / true["m00"]
        # The edges pull in a pose that is off by a tenth of the size of a die of 80 px, and by an eighth of its distance.
        assert np.linalg.norm(blob.centre_px - middle) < 0.1 * np.sqrt(true["m00"])
        assert blob.area_px == pytest.approx(true["m00"], rel=0.25)


def test_a_die_in_the_picture_does_not_raise_the_noise_of_the_table() -> None:
    rng = np.random.default_rng(5)
    images = [photograph(ROOM, DICE["cube"], still(rng), rng) for _ in range(4)]
    # The median of 40 000 pixels has an error of 1 %; a fifth of them, under the die, only raise it.
    assert background_noise(images, ROOM.table) == pytest.approx(2.0, rel=0.25)
    assert background_noise([ROOM.table], ROOM.table) == 0.3


@pytest.mark.parametrize("noise_grey", [0.2, 0.4, 0.8, 1.2, 1.7, 2.9])
@pytest.mark.parametrize("step_grey", [1.0, 16.0])
def test_the_noise_of_rounded_pixels_is_no_whole_step(noise_grey: float, step_grey: float) -> None:
    rng = np.random.default_rng(round(10 * noise_grey))
    table = step_grey * np.rint(ROOM.table / step_grey)
    images = [step_grey * np.rint(table / step_grey + noise_grey * rng.normal(size=table.shape)) for _ in range(3)]
    # 10 000 pixels: 2 %, and up to twice that where few lie beyond the half step. Rounding adds a twelfth of a step squared.
    assert background_noise(images, table, step_grey) == pytest.approx(step_grey * np.hypot(noise_grey, 0.3), rel=0.05)
    known = background_noise(images[:1], table, step_grey)
    unknown = np.where(np.arange(len(table))[:, None] % 50, table, np.nan)
    assert background_noise(images[:1], unknown, step_grey) == pytest.approx(known, rel=0.02)


def test_noise_that_a_codec_leaves_about_the_die_alone_is_that_of_the_clip() -> None:
    quiet = replace(ROOM, noise_grey=0.0)
    pictures = [np.asarray(ROOM.table, np.float32)]
    for seed in range(4):
        rng = np.random.default_rng([6, seed])
        image = photograph(quiet, DICE["cube"], still(rng, 0.012), rng)
        near = cv2.dilate((np.abs(image - ROOM.table) > 8.0).astype(np.uint8), np.ones((81, 81), np.uint8))
        pictures.append(np.asarray(image + near * rng.normal(scale=2.0, size=image.shape), np.float32))
    assert background_noise(pictures, ROOM.table) == 0.3
    # The mean over 7 x 7 pixels takes a fiftieth of the variance away, and the penumbra adds some.
    assert pixel_noise(pictures, ROOM.table).noise_grey == pytest.approx(2.0, rel=0.1)
    assert noise_beside_die(ROOM.table, ROOM.table, 0.3) == 0.0


def test_what_differs_clearly_is_the_die_without_its_faint_shadow() -> None:
    faint = replace(ROOM, noise_grey=0.5, shadow=0.04)
    rng = np.random.default_rng(8)
    state = still(rng, 0.012)
    image = photograph(faint, DICE["cube"], state, rng)
    die = np.abs(photograph(replace(faint, shadow=0.0), DICE["cube"], state) - ROOM.table) > 8.0
    mask = differs_from_background(image, ROOM.table, 0.5)
    clear = differs_clearly(image, ROOM.table, mask)
    assert mask.sum() > 1.3 * die.sum()
    assert (clear & die).sum() > 0.9 * die.sum()
    assert (clear & ~die).sum() < 0.1 * die.sum()
    assert not differs_clearly(ROOM.table, ROOM.table, np.zeros(image.shape, bool)).any()


def test_the_step_between_grey_levels_is_that_of_the_rounding() -> None:
    rng = np.random.default_rng(5)
    images = [np.rint(photograph(ROOM, DICE["cube"], still(rng), rng)) for _ in range(2)]
    assert level_step(images) == 1.0
    assert level_step([np.floor(image / 16.0) * 16.0 for image in images]) == 16.0
    # Levels stretched to the full scale lie 36 or 37 apart.
    assert level_step([np.rint(np.floor(image / 32.0) * 255.0 / 7.0) for image in images]) == 36.0
    assert level_step([np.zeros((20, 20), np.float32)]) == 1.0
    table = [np.floor(ROOM.table / 16.0) * 16.0]
    # Rounding errors are uniform over a step, whose standard deviation is 0.29.
    assert background_noise(table, table[0], 16.0) == pytest.approx(16.0 / np.sqrt(12.0), rel=0.05)


def test_rounding_errors_are_correlated_only_if_wider_than_the_noise() -> None:
    assert rounding_is_correlated(16.0, 2.0)
    assert not rounding_is_correlated(1.0, 0.3)
    assert not rounding_is_correlated(16.0, 16.0 * DITHERED)
    # With noise of half a step the mean of many pixels of one grey is off by no more than a four hundredth of a step.
    rng = np.random.default_rng(1)
    greys = np.linspace(0.0, 1.0, 21)
    means = np.array([np.floor(grey + DITHERED * rng.normal(size=200_000) + 0.5).mean() for grey in greys])
    assert np.abs(means - greys).max() < 1.0 / 400.0 + 4.0 * np.sqrt(DITHERED**2 + 1.0 / 12.0) / np.sqrt(200_000)


def test_the_largest_region_is_reported_with_its_position() -> None:
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
