"""`track` names a second die in view among its notices."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from footage_files import write_tiff
from footage_of_throws import DICE, FPS, falling_cube, photograph, studio

from diethrow.commands.clip.track import track_scene
from diethrow.files.scene import read_scene

FRAMES = 36
ROOM = replace(studio(320, 260), noise_grey=2.0)


def test_the_notices_of_a_track_name_a_second_die(tmp_path: Path) -> None:
    die, throw, rng = DICE["cube"], falling_cube(FRAMES / FPS), np.random.default_rng(3)
    frames = []
    for k in range(FRAMES):
        state = throw.at(k / FPS)
        beside = replace(state, position_m=state.position_m + np.array([0.026, 0.004, 0.0]))
        table = photograph(replace(ROOM, noise_grey=0.0), die, beside)
        frames.append(np.clip(np.rint(photograph(replace(ROOM, table=table), die, state, rng)), 0, 255))
    write_tiff(tmp_path / "clip.tif", np.array(frames).astype(np.uint8))
    cv2.imwrite(str(tmp_path / "background.png"), np.rint(ROOM.table).astype(np.uint8))
    camera = ROOM.camera
    lines = [
        "[clip]", 'path = "clip.tif"', f"fps = {FPS}", 'background = "background.png"',
        "[camera]", f"width = {camera.width_px}", f"height = {camera.height_px}",
        *(f"{name} = {getattr(camera, name).tolist()}" for name in ("matrix", "distortion", "rotation", "translation_m")),
        "[table]", 'surface = "wood"',
        "[die]", 'shape = "cube"', f"edge_m = {die.solid.edge_m}", f"mass_kg = {die.mass_kg}", "corner_radius_m = 0.0",
    ]  # fmt: skip
    (tmp_path / "scene.toml").write_text("\n".join(lines) + "\n")
    tracking = track_scene(read_scene(tmp_path / "scene.toml"))
    named = [notice for notice in tracking.notices if "size of a die beside the tracked one" in notice]
    assert len(named) == 1
    assert named[0].endswith("give the first pose by hand ([start]).")
