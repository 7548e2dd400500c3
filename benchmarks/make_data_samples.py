"""Make the clips in data_samples/ from the lossless original of cube_wood.

    PYTHONPATH=tests/helpers python benchmarks/make_data_samples.py ORIGINAL_FOLDER data_samples

The original (17 MB) is not in the repository. The error of both samples against it is printed, and is in data_samples/README.md.
"""

from __future__ import annotations

import shutil
import sys
import tomllib
from pathlib import Path

import cv2
import numpy as np
from footage_files import write_photron, write_video
from numpy.typing import NDArray

from diethrow.tracking.footage.background import load_background
from diethrow.tracking.footage.clip import open_clip

FPS = 1500
X264 = {"preset": "veryslow", "crf": "6.7", "tune": "psnr", "g": "60"}
"""tune=psnr turns off x264's psychovisual optimisation, which shifts edges: without it the error is 1.7 times as large at the
same size."""
FIRST, STOP = 90, 130
"""Frames of the Photron sample: 15 of flight, two impacts (105.4 and 116.8), 13 of flight."""
LEFT, TOP, WIDTH, HEIGHT = 86, 136, 152, 216
"""Its window [px], which holds the die on all of these frames."""


def main(original: Path, samples: Path) -> None:
    """Write both samples and print what the first one loses."""
    clip = open_clip(original / "clip.avi", fps=FPS)
    frames = np.stack(list(clip.frames()))
    background = load_background(original / "background.png", clip).astype(np.uint8)
    make_video(original, samples / "cube_wood", frames)
    make_photron(original, samples / "cube_wood_photron", frames, background)
    print_loss(frames, np.stack(list(open_clip(samples / "cube_wood" / "clip.mp4", fps=FPS).frames())), background)


def make_video(original: Path, folder: Path, frames: NDArray[np.uint8]) -> None:
    """The whole clip as monochrome H.264; scene and background as they are."""
    folder.mkdir(parents=True, exist_ok=True)
    write_video(folder / "clip.mp4", frames, codec="libx264", pixels="gray", fps=FPS, options=X264)
    shutil.copyfile(original / "background.png", folder / "background.png")
    scene = (original / "scene.toml").read_text().replace("clip.avi", "clip.mp4")
    (folder / "scene.toml").write_text(scene)


def make_photron(original: Path, folder: Path, frames: NDArray[np.uint8], background: NDArray[np.uint8]) -> None:
    """A window of 40 frames, 8 bit shifted up to fill 12, and the camera of that window."""
    folder.mkdir(parents=True, exist_ok=True)
    window = np.s_[TOP : TOP + HEIGHT, LEFT : LEFT + WIDTH]
    cut = frames[(slice(FIRST, STOP), *window)].astype(np.uint16) << 4
    write_photron(folder / "clip.cihx", cut, stored_bits=12, record_rate_hz=FPS, shutter_hz=5000, start_frame=FIRST)
    cv2.imwrite(str(folder / "background.png"), background[window].astype(np.uint16) << 4)
    text = (original / "scene.toml").read_text()
    matrix = tomllib.loads(text)["camera"]["matrix"]
    moved = [[matrix[0][0], 0.0, matrix[0][2] - LEFT], [0.0, matrix[1][1], matrix[1][2] - TOP], [0.0, 0.0, 1.0]]
    for old, new in {
        "# cube_wood: one throw": f"# The window x {LEFT}, y {TOP} of frames {FIRST} to {STOP - 1} of cube_wood: one throw",
        "clip.avi": "clip.cihx",
        "width = 384": f"width = {WIDTH}",
        "height = 384": f"height = {HEIGHT}",
        str(matrix): str(moved),
    }.items():
        assert old in text, old
        text = text.replace(old, new)
    (folder / "scene.toml").write_text(text)


def print_loss(frames: NDArray[np.uint8], coded: NDArray[np.uint8], background: NDArray[np.uint8]) -> None:
    """Grey-level error of the coded clip, near the die and elsewhere."""
    die = np.stack([np.abs(frame.astype(int) - background) > 40 for frame in frames]).astype(np.uint8)
    near = np.stack([cv2.dilate(mask, np.ones((9, 9), np.uint8)) for mask in die]).astype(bool)
    error = coded.astype(int) - frames
    for name, part in (("near the die", near), ("elsewhere", ~near)):
        print(f"{name}: bias {error[part].mean():+.3f}, rms {error[part].std():.2f} grey levels")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
