"""Laws of the footage of a scene: frames as the camera was calibrated for them, and the order in which rows are exposed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from footage_files import noisy_frames, with_display_matrix, write_pictures, write_video

from diethrow.commands.clip.footage import open_background, open_footage, open_frames, readout_of_frames
from diethrow.files.scene import Scene, read_scene
from diethrow.files.settings import SceneError
from diethrow.tracking.check import Verdict, frame_timing, judge_throw
from diethrow.tracking.footage import smoothed

FRAMES = noisy_frames(6)
"""(6, 48, 64)."""
CLOCKWISE, HALF = (0, 1, -1, 0), (-1, 0, 0, -1)
"""Display matrices a, b, c, d of a quarter turn and of half a turn."""


def scene_of(folder: Path, matrix: tuple[int, int, int, int], size: tuple[int, int], readout_s: float = 0.0) -> Scene:
    """The scene of an MP4 with a display matrix, and of a camera of (width, height)."""
    film = write_video(folder / "x.mp4", FRAMES, fps=30, codec="libx264", options={"qp": "0"})
    with_display_matrix(film, *matrix)
    return read_scene(scene_file(folder, "x.mp4", size, f"readout_s = {readout_s}"))


def scene_file(folder: Path, clip: str, size: tuple[int, int], keys: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(
        f"""
[clip]
path = "{clip}"
fps = 500.0
{keys}
[camera]
width = {size[0]}
height = {size[1]}
matrix = [[300.0, 0.0, {(size[0] - 1) / 2}], [0.0, 300.0, {(size[1] - 1) / 2}], [0.0, 0.0, 1.0]]
rotation = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
translation_m = [0.0, 0.0, 0.5]
[table]
surface = "wood"
[die]
shape = "cube"
edge_m = 0.016
mass_kg = 0.0048
"""
    )
    return path


def test_a_camera_of_turned_frames_sees_them_turned(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, CLOCKWISE, (48, 64))
    clip = open_footage(scene, scene.views()[0])
    np.testing.assert_array_equal(clip.frame(2), np.rot90(FRAMES[2], -1))
    assert "turned by 90° clockwise" in clip.notices[0]


def test_a_camera_of_stored_frames_sees_them_as_they_are_stored(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, CLOCKWISE, (64, 48), readout_s=1e-3)
    view = scene.views()[0]
    clip = open_footage(scene, view)
    np.testing.assert_array_equal(clip.frame(2), FRAMES[2])
    np.testing.assert_array_equal(open_frames(scene, view, (2, 4)).frame(0), FRAMES[2])
    assert "as they are stored" in clip.notices[0]
    assert readout_of_frames(scene, [clip]) is scene


def test_a_camera_of_neither_size_is_refused_with_the_turned_size(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, CLOCKWISE, (32, 24))
    with pytest.raises(SceneError, match=r"48 × 64 px, as the file asks players to; wanted their own camera"):
        open_footage(scene, scene.views()[0])


def test_half_a_turn_reverses_the_order_of_rows(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, HALF, (64, 48), readout_s=1e-3)
    clip = open_footage(scene, scene.views()[0])
    np.testing.assert_array_equal(clip.frame(2), FRAMES[2, ::-1, ::-1])
    assert readout_of_frames(scene, [clip]).clip.readout_s == -1e-3
    assert readout_of_frames(readout_of_frames(scene, [clip]), [clip]).clip.readout_s == 1e-3


def test_a_quarter_turn_with_a_readout_is_refused_with_its_key(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, CLOCKWISE, (48, 64), readout_s=1e-3)
    clip = open_footage(scene, scene.views()[0])
    with pytest.raises(SceneError, match=r"clip\.readout_s = 0\.001: .*columns are exposed one after the other"):
        readout_of_frames(scene, [clip])


def test_clips_that_are_turned_differently_have_no_common_readout(tmp_path: Path) -> None:
    upside_down = scene_of(tmp_path, HALF, (64, 48), readout_s=1e-3)
    clips = [open_frames(upside_down, upside_down.views()[0], None)]
    upright = scene_of(tmp_path, (1, 0, 0, 1), (64, 48), readout_s=1e-3)
    clips.append(open_frames(upright, upright.views()[0], None))
    with pytest.raises(SceneError, match=r"clip\.readout_s = 0\.001: some of the clips are turned by 180°"):
        readout_of_frames(upright, clips)


def test_a_mosaic_is_removed_from_frames_parts_and_background_alike_and_reported(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    cells = np.tile([[50.0, 90.0], [90.0, 60.0]], (48, 64))
    frames = np.rint(cells + 2.0 * rng.standard_normal((12, *cells.shape))).astype(np.uint8)
    write_pictures(tmp_path / "frames", frames)
    write_pictures(tmp_path / "empty", frames[:1])
    path = scene_file(tmp_path, "frames", (128, 96), 'background = "empty/frame_1.png"')
    scene = read_scene(path)
    view = scene.views()[0]
    clip = open_footage(scene, view)
    np.testing.assert_array_equal(clip.frame(4), smoothed(frames[4]))
    np.testing.assert_array_equal(open_frames(scene, view, (4, 5), part_of=clip).frame(0), smoothed(frames[4]))
    background = open_background(scene, view, clip)
    assert background is not None
    assert float(np.abs(background - smoothed(frames[0].astype(np.float32))).max()) < 1e-4
    assert "frames: the frames are the raw mosaic of a colour sensor" in clip.notices[0]
    timing, mosaic, *_ = judge_throw(
        frame_timing(clip, clip.notices), None, (np.empty(0), np.empty(0)), scene.die, None
    )
    assert (timing.name, timing.verdict) == ("timing", Verdict.GOOD)
    assert (mosaic.name, mosaic.verdict) == ("mosaic", Verdict.DOUBTFUL)
