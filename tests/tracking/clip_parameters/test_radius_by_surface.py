"""Laws of the corner radius by the whole surface: that of a rounded die is found, and nothing that smears an edge rounds one."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from footage_of_throws import DICE, Image, Studio, photograph, studio
from random_throws import random_quaternion
from rounded_dice import photograph_rounded

from diethrow.model.die.die import Die
from diethrow.model.die.solid import SHAPES
from diethrow.model.throw.motion import State
from diethrow.tracking.clip_parameters.corner_radius import SampledFrames
from diethrow.tracking.clip_parameters.radius_by_surface import radius_by_surface, surface_gain_over_sharp

STUDIO = replace(studio(), noise_grey=2.0)
CUBE = DICE["cube"]
FRAMES = 10
PX_PER_M = 3750.0
"""Scale in the middle of the studio's picture."""


def sampled(setting: Studio, die: Die, *, gloss_grey: float = 0.0, quality: int | None = None) -> SampledFrames:
    """Pictures of a die at rest in random orientations, at its true poses, of a JPEG file where its quality is given."""
    pictures: list[Image] = []
    states: list[State] = []
    for k in range(FRAMES):
        rng = np.random.default_rng([5, k])
        position = np.array([*rng.uniform(-2e-3, 2e-3, 2), 0.018])
        state = State(0.0, position, random_quaternion(rng), np.zeros(3), np.zeros(3))
        picture = (
            photograph_rounded(setting, die, state, rng, gloss_grey=gloss_grey)
            if die.corner_radius_m > 0.0
            else photograph(setting, die, state, rng)
        )
        if quality is not None:
            file = cv2.imencode(
                ".jpg", np.rint(picture).clip(0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality]
            )[1]
            picture = cv2.imdecode(file, cv2.IMREAD_GRAYSCALE).astype(picture.dtype)
        pictures.append(picture)
        states.append(state)
    return SampledFrames(
        tuple(picture[None] for picture in pictures),
        np.array([state.position_m for state in states]),
        np.array([state.rotation for state in states]),
        np.zeros((FRAMES, 6)),
    )


@pytest.mark.parametrize("gloss_grey", [0.0, 60.0])
@pytest.mark.parametrize("radius_m", [0.6e-3, 1.2e-3, 2.5e-3])
def test_the_radius_of_a_rounded_die_is_found(radius_m: float, gloss_grey: float) -> None:
    found = radius_by_surface(
        STUDIO.view(CUBE), sampled(STUDIO, replace(CUBE, corner_radius_m=radius_m), gloss_grey=gloss_grey)
    )
    assert found is not None
    assert found.is_rounded
    assert abs(found.best.radius_m - radius_m) < 0.15 * radius_m
    assert not found.is_sharp


@pytest.mark.parametrize("shape", SHAPES)
def test_a_sharp_die_is_not_rounded(shape: str) -> None:
    die = DICE[shape]
    found = radius_by_surface(STUDIO.view(die), sampled(STUDIO, die))
    assert found is not None
    assert not found.is_rounded
    # Bevels of a dodecahedron change its outline least.
    assert found.most_m < 3.0 / PX_PER_M


@pytest.mark.parametrize("shape", SHAPES)
def test_a_codec_rounds_no_die(shape: str) -> None:
    """Where it leaves the corners: JPEG of quality 15 rounds those of a cube by three pixels."""
    die = DICE[shape]
    found = radius_by_surface(STUDIO.view(die), sampled(STUDIO, die, quality=60))
    assert found is not None
    assert not found.is_rounded


def shadowed(frames: SampledFrames, setting: Studio, die: Die, darkness: float, penumbra_px: float) -> SampledFrames:
    """The frames, six of which show a shadow as large as the die on the table beside it."""
    background, pictures = setting.view(die).backgrounds[0], list(frames.pictures)
    for k in range(6):
        picture = pictures[k][0]
        is_die = (
            cv2.morphologyEx((abs(picture - background) > 12).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7))) > 0
        )
        (y, x), (rows, columns) = (part.mean() for part in np.nonzero(is_die)), np.indices(picture.shape)
        radius_px, heading = np.sqrt(is_die.sum() / np.pi), np.random.default_rng(k).uniform(0.0, 2.0 * np.pi)
        x, y = x + 0.5 * radius_px * np.cos(heading), y + 0.5 * radius_px * np.sin(heading)
        beyond = np.hypot(columns - x, rows - y) - radius_px
        shade = 1.0 - darkness / (1.0 + np.exp(beyond / penumbra_px))
        pictures[k] = np.where(is_die, picture, picture * shade).astype(picture.dtype)[None]
    return replace(frames, pictures=tuple(pictures))


@pytest.mark.parametrize(("darkness", "penumbra_px"), [(0.2, 4.0), (0.35, 6.0), (0.5, 10.0)])
def test_a_shadow_beside_a_die_rounds_none(darkness: float, penumbra_px: float) -> None:
    """On a part of the frames, of a codec that leaves corners a little round."""
    frames = shadowed(sampled(STUDIO, CUBE, quality=60), STUDIO, CUBE, darkness, penumbra_px)
    found = radius_by_surface(STUDIO.view(CUBE), frames)
    assert found is not None
    assert not found.is_rounded


@pytest.mark.parametrize("blur_px", [1.2, 2.4])
@pytest.mark.parametrize("shape", ["tetrahedron", "cube"])
def test_a_die_out_of_focus_is_not_rounded(shape: str, blur_px: float) -> None:
    setting, die = replace(STUDIO, blur_px=blur_px), DICE[shape]
    found = radius_by_surface(setting.view(die), sampled(setting, die))
    assert found is not None
    assert not found.is_rounded


@pytest.mark.parametrize("is_rounded_die", [False, True])
def test_the_surface_tells_which_corners_a_die_has_at_the_poses_of_each(is_rounded_die: bool) -> None:
    radius_m = 8.0 / PX_PER_M
    frames = sampled(STUDIO, replace(CUBE, corner_radius_m=radius_m if is_rounded_die else 0.0))
    found = surface_gain_over_sharp(STUDIO.view(CUBE), radius_m, frames, frames)
    assert found is not None
    gain, sigma = found
    assert (gain > 3.0 * sigma) is is_rounded_die
    assert (gain < -3.0 * sigma) is not is_rounded_die


def test_nothing_is_said_of_few_frames_or_a_small_radius() -> None:
    frames, view = sampled(STUDIO, CUBE), STUDIO.view(CUBE)
    assert radius_by_surface(view, frames.sample(5)) is None
    assert surface_gain_over_sharp(view, 1.1 / PX_PER_M, frames, frames) is None
    assert surface_gain_over_sharp(view, 4.0 / PX_PER_M, frames.sample(5), frames.sample(5)) is None
