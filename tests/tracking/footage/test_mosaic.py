"""Laws of raw mosaics: each is recognised and leaves nothing behind, and no ordinary picture is taken for one."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from footage_files import write_video
from numpy.typing import NDArray
from replay_records import ArrayClip

from diethrow.tracking.footage.clip import FillsFrames, open_clip
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.footage.images import read_picture
from diethrow.tracking.footage.mosaic import clip_without_mosaic, find_mosaic, mosaic_of, smoothed

SAMPLES = Path(__file__).parents[3] / "data_samples"
SIZE_PX = 240
FILTERS = {
    "daylight": np.array([[0.55, 1.0], [1.0, 0.65]]),
    "blue first": np.array([[0.65, 1.0], [1.0, 0.55]]),
    "green first": np.array([[1.0, 0.55], [0.65, 1.0]]),
    # Red and blue are together as bright as the greens: no chequer, but columns and rows.
    "lamplight": np.array([[1.35, 1.0], [1.0, 0.65]]),
}
"""Sensitivities of the pixels of a cell to the light of a scene."""


def grey_scene(seed: int = 3) -> NDArray[np.float64]:
    """Smooth texture over the picture, about level 90."""
    rough = np.random.default_rng(seed).normal(size=(SIZE_PX, SIZE_PX))
    fine, coarse = (cv2.GaussianBlur(rough, (0, 0), sigma) for sigma in (1.0, 12.0))
    return np.asarray(90.0 + 8.0 * fine / fine.std() + 25.0 * coarse / coarse.std())


def filtered(scene: NDArray[np.float64], cell: NDArray[np.float64]) -> NDArray[np.float64]:
    return scene * np.tile(cell, (scene.shape[0] // 2, scene.shape[1] // 2))


def seen(levels: NDArray[np.float64], noise_grey: float = 2.0, seed: int = 4) -> NDArray[np.uint8]:
    """The picture in 8 bits, with noise."""
    noise = noise_grey * np.random.default_rng(seed).standard_normal(levels.shape)
    return np.asarray(np.clip(np.rint(levels + noise), 0, 255), np.uint8)


def cloth(period_px: float, turn_deg: float, sharp: bool) -> NDArray[np.float64]:
    """A chequered cloth with squares of half a period."""
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX]
    turn = np.radians(turn_deg)
    u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    wave = np.sin(2 * np.pi * u / period_px + 0.3) * np.sin(2 * np.pi * v / period_px + 0.7)
    return np.asarray(100.0 + 60.0 * (np.sign(wave) if sharp else wave))


@pytest.mark.parametrize("noise_grey", [0.0, 2.0, 10.0])
@pytest.mark.parametrize("name", list(FILTERS))
def test_every_mosaic_is_recognised_with_its_levels(name: str, noise_grey: float) -> None:
    cell = FILTERS[name]
    found = find_mosaic(seen(filtered(grey_scene(), cell), noise_grey))
    assert found is not None
    # Clipping at full scale takes a little from the brightest.
    np.testing.assert_allclose(found.level_shares, cell / cell.mean(), rtol=0.02)


def test_a_mosaic_is_recognised_behind_things_of_other_colours() -> None:
    levels = filtered(grey_scene(), FILTERS["daylight"])
    levels[60:130, 60:130] = filtered(grey_scene(), np.array([[1.4, 0.6], [0.6, 0.4]]))[60:130, 60:130]
    assert find_mosaic(seen(levels)) is not None


@pytest.mark.parametrize("noise_grey", [0.5, 2.0, 10.0, 40.0])
def test_noise_and_texture_are_no_mosaic(noise_grey: float) -> None:
    for seed in range(20):
        assert find_mosaic(seen(grey_scene(seed), noise_grey, seed)) is None
        assert find_mosaic(seen(np.full((SIZE_PX, SIZE_PX), 6.0), noise_grey, seed)) is None


@pytest.mark.parametrize("sharp", [True, False])
@pytest.mark.parametrize("turn_deg", [0.0, 1.0, 17.0, 45.0])
@pytest.mark.parametrize("period_px", [1.97, 2.02, 2.1, 2.5, 3.0, 4.0, 5.3, 8.0, 16.0, 32.0])
def test_a_chequered_cloth_is_no_mosaic(period_px: float, turn_deg: float, sharp: bool) -> None:
    assert find_mosaic(seen(cloth(period_px, turn_deg, sharp))) is None


@pytest.mark.parametrize("quality", [10, 40, 90])
@pytest.mark.parametrize("scene", [grey_scene(), cloth(4.0, 0.0, True), cloth(7.0, 10.0, True)])
def test_compression_is_no_mosaic(scene: NDArray[np.float64], quality: int) -> None:
    _, code = cv2.imencode(".jpg", seen(scene), [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert find_mosaic(cv2.imdecode(code, cv2.IMREAD_GRAYSCALE)) is None


def test_enlarged_and_sharpened_pictures_are_no_mosaic() -> None:
    small = seen(grey_scene())[: SIZE_PX // 2, : SIZE_PX // 2]
    for how in (cv2.INTER_NEAREST, cv2.INTER_LINEAR, cv2.INTER_CUBIC):
        assert find_mosaic(cv2.resize(small, (SIZE_PX, SIZE_PX), interpolation=how)) is None
    picture = seen(grey_scene()).astype(np.float32)
    assert find_mosaic(picture + 1.5 * (picture - cv2.GaussianBlur(picture, (0, 0), 1.0))) is None
    assert find_mosaic(np.kron(np.eye(120), np.ones((2, 2)))) is None


@pytest.mark.parametrize("crf", [20, 34])
def test_compressed_films_keep_their_kind(crf: int, tmp_path: Path) -> None:
    options = {"crf": str(crf)}
    for name, levels in (("grey", grey_scene()), ("mosaic", filtered(grey_scene(), FILTERS["daylight"]))):
        frames = np.stack([seen(levels, seed=k) for k in range(5)])
        film = write_video(tmp_path / f"{name}.mp4", frames, fps=30, codec="libx264", options=options)
        assert (mosaic_of(open_clip(film, fps=500)) is not None) == (name == "mosaic")


@pytest.mark.parametrize("background", sorted(SAMPLES.glob("*/background.png")), ids=lambda path: path.parent.name)
def test_the_samples_are_no_mosaics(background: Path) -> None:
    assert find_mosaic(read_picture(background)) is None


def test_a_small_picture_is_not_judged() -> None:
    assert find_mosaic(seen(filtered(grey_scene(), FILTERS["daylight"]))[:60, :90]) is None


@pytest.mark.parametrize("cell", FILTERS.values(), ids=FILTERS)
def test_smoothing_leaves_nothing_of_a_pattern(cell: NDArray[np.float64]) -> None:
    flat = smoothed(filtered(np.full((SIZE_PX, SIZE_PX), 80.0), cell))
    np.testing.assert_allclose(flat, 80.0 * cell.mean(), rtol=1e-12)  # the border as well
    whole = smoothed(filtered(np.full((64, 64), 80.0), cell).round().astype(np.uint8))
    assert int(whole.max()) - int(whole.min()) <= 1


@pytest.mark.parametrize("bit_depth", [8, 12])
def test_every_way_of_reading_smooths_alike(bit_depth: int, tmp_path: Path) -> None:
    levels = np.clip(filtered(grey_scene(), FILTERS["daylight"]), 0, 240) * 2 ** (bit_depth - 8)
    dtype, pixels = (np.uint8, "gray") if bit_depth == 8 else (np.uint16, "gray12le")
    frames = np.stack([levels + k for k in range(6)]).astype(dtype)
    in_memory = ArrayClip(frames, np.arange(6) / 500.0, bit_depth)
    in_file = open_clip(write_video(tmp_path / "x.mkv", frames, pixels=pixels, fps=30), fps=500)
    assert isinstance(in_file, FillsFrames)
    assert not isinstance(in_memory, FillsFrames)
    wanted = np.stack([smoothed(frame) for frame in frames])
    for clip in (in_memory, in_file):
        without = clip_without_mosaic(clip, "a notice")
        assert without.notices[-1] == "a notice"
        assert isinstance(without, FillsFrames) == isinstance(clip, FillsFrames)
        np.testing.assert_array_equal(np.stack(list(without.frames())), wanted)
        np.testing.assert_array_equal(without.frame(3), wanted[3])
        boxes = np.array(
            [[0, 0, 30, 20], [7, 9, 8, 10], [5, 5, 5, 5], [200, 210, 240, 240], [0, 0, 240, 240], [1, 1, 9, 9]]
        )
        for block in FrameSource([without]).blocks_within(boxes):
            with block:
                for k, picture in enumerate(block.frames):
                    x0, y0, x1, y1 = boxes[block.first + k]
                    np.testing.assert_array_equal(picture[0, y0:y1, x0:x1], wanted[block.first + k, y0:y1, x0:x1])
