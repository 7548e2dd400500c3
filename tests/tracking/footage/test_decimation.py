"""Laws of clips of which a part is used: the same scene, seen less often or by fewer pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from diethrow.tracking.camera import Camera
from diethrow.tracking.footage.clip import open_clip
from diethrow.tracking.footage.decimation import WHOLE, Coarseness

CLIP = Path(__file__).parents[3] / "data_samples" / "cube_wood_photron" / "clip.cihx"


def test_every_nth_frame_is_the_clips_own() -> None:
    clip = open_clip(CLIP)
    fewer = Coarseness(every=3).clip(clip)
    assert len(fewer) == (len(clip) + 2) // 3
    np.testing.assert_array_equal(fewer.times_s, clip.times_s[::3])
    for k, frame in enumerate(fewer.frames(1, 4), start=1):
        np.testing.assert_array_equal(frame, clip.frame(3 * k))


def test_a_smaller_picture_is_the_mean_of_squares() -> None:
    clip = open_clip(CLIP)
    smaller = Coarseness(shrink=2).clip(clip)
    whole, half = clip.frame(5).astype(float), smaller.frame(5)
    assert half.shape == (clip.height_px // 2, clip.width_px // 2)
    assert half.dtype == clip.frame(5).dtype
    # Rounded to the clip's own depth.
    assert abs(half[3, 4] - whole[6:8, 8:10].mean()) <= 0.5


def test_a_smaller_camera_sees_a_point_where_the_smaller_picture_has_it() -> None:
    rng = np.random.default_rng(2)
    camera = Camera(
        384, 256, np.array([[900.0, 0.0, 190.0], [0.0, 910.0, 120.0], [0.0, 0.0, 1.0]]),
        np.array([0.1, -0.05, 1e-3, 2e-3, 0.0]), np.eye(3), np.array([0.0, 0.0, 0.5]),
    )  # fmt: skip
    points = rng.uniform(-0.05, 0.05, (20, 3))
    for f in (2, 3, 4):
        seen = Coarseness(shrink=f).camera(camera).project(points)
        np.testing.assert_allclose(seen, (camera.project(points) - 0.5 * (f - 1)) / f, atol=1e-9)


def test_frame_numbers_and_excluded_ranges_are_those_of_the_file() -> None:
    less = Coarseness(every=4)
    np.testing.assert_array_equal(less.numbers(np.arange(10, 14)), [10, 14, 18, 22])
    # Frames 14 and 18 of 10, 14, 18, 22 lie in [13, 19): the second and third, counted from 10.
    assert less.rows(10, ((13, 19),)) == ((11, 13),)


def test_all_of_a_clip_is_the_clip() -> None:
    clip = open_clip(CLIP)
    assert WHOLE.clip(clip) is clip


def test_too_little_left_is_refused() -> None:
    clip = open_clip(CLIP)
    with pytest.raises(ValueError, match="shrink = 1000 leaves"):
        Coarseness(shrink=1000).clip(clip)
    with pytest.raises(ValueError, match="every = 100000 leaves 1 frame"):
        Coarseness(every=100000).clip(clip)
    with pytest.raises(ValueError, match="every = 0"):
        Coarseness(every=0)
