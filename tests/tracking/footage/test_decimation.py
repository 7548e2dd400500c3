"""Laws of decimation: the same scene in fewer frames, or by fewer pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from replay_records import ArrayClip

from diethrow.tracking.camera import Camera
from diethrow.tracking.footage.clip import open_clip
from diethrow.tracking.footage.decimation import WHOLE_CLIP, Decimation

CLIP = Path(__file__).parents[3] / "data_samples" / "cube_wood_photron" / "clip.cihx"


def test_every_nth_frame_is_the_clips_own() -> None:
    clip = open_clip(CLIP)
    fewer = Decimation(every=3).clip(clip)
    assert len(fewer) == (len(clip) + 2) // 3
    np.testing.assert_array_equal(fewer.times_s, clip.times_s[::3])
    for k, frame in enumerate(fewer.frames(1, 4), start=1):
        np.testing.assert_array_equal(frame, clip.frame(3 * k))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("f", [2, 3, 4, 6])
def test_a_smaller_frame_is_the_mean_of_squares_rounded_half_to_even(dtype: type, f: int) -> None:
    frames = np.random.default_rng(f).integers(0, np.iinfo(dtype).max + 1, (2, 101, 100), dtype)
    smaller = Decimation(shrink=f).clip(ArrayClip(frames, np.arange(2) / 1000.0, 8 * frames.itemsize)).frame(1)
    height, width = 101 // f, 100 // f
    means = frames[1, : height * f, : width * f].astype(float).reshape(height, f, width, f).mean((1, 3))
    assert smaller.dtype == dtype
    np.testing.assert_array_equal(smaller, np.rint(means))


def test_the_smaller_camera_projects_a_point_to_its_place_in_the_smaller_picture() -> None:
    rng = np.random.default_rng(2)
    camera = Camera(
        384, 256, np.array([[900.0, 0.0, 190.0], [0.0, 910.0, 120.0], [0.0, 0.0, 1.0]]),
        np.array([0.1, -0.05, 1e-3, 2e-3, 0.0]), np.eye(3), np.array([0.0, 0.0, 0.5]),
    )  # fmt: skip
    points = rng.uniform(-0.05, 0.05, (20, 3))
    for f in (2, 3, 4):
        seen = Decimation(shrink=f).camera(camera).project(points)
        np.testing.assert_allclose(seen, (camera.project(points) - 0.5 * (f - 1)) / f, atol=1e-9)


def test_frame_numbers_and_excluded_ranges_are_those_of_the_file() -> None:
    less = Decimation(every=4)
    np.testing.assert_array_equal(less.frame_numbers(np.arange(10, 14)), [10, 14, 18, 22])
    # Frames 14 and 18 of 10, 14, 18, 22 lie in [13, 19): the second and third, counted from 10.
    assert less.frame_ranges(10, ((13, 19),)) == ((11, 13),)


def test_without_decimation_the_clip_itself_is_returned() -> None:
    clip = open_clip(CLIP)
    assert WHOLE_CLIP.clip(clip) is clip


def test_a_decimation_that_leaves_too_little_is_refused() -> None:
    clip = open_clip(CLIP)
    with pytest.raises(ValueError, match="shrink = 1000"):
        Decimation(shrink=1000).clip(clip)
    with pytest.raises(ValueError, match="every = 100000"):
        Decimation(every=100000).clip(clip)
    with pytest.raises(ValueError, match="every = 0"):
        Decimation(every=0)
