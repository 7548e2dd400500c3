"""Long clips: memory and speed from packed 12-bit pixels to tables, `PYTHONPATH=tests/helpers python benchmarks/long_clip.py`

A cube falls and bounces in a picture of 512 × 512 pixels. The throw is rendered with the requested number of frames, at the
rate that this needs, into an .mraw of packed 12-bit pixels, 0.4 MB a frame. Every clip is tracked in a separate process.

  unpacked   frames a second of unpacking alone: bytes to grey levels
  decoded    frames a second of the reader, from a file in the system's cache
  tracked    frames a second from the file to the tables on disk, as `diethrow track` writes them
  CPU        processor time of that [ms a frame]
  from mem.  frames a second from decoded frames in memory, for clips of at most MOST_HELD frames
  MB         peak memory of the process, and its memory before tracking: code and libraries
  poses      share of the frames with a pose

Rates need an idle machine; processor time does not.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from footage_files import pack, write_photron
from footage_of_throws import DICE, Studio, photograph, pips, studio
from measuring import peak_MB, timed
from numpy.typing import NDArray
from replay_records import ArrayClip

from diethrow.commands.clip.footage import open_footage
from diethrow.commands.clip.track import track_only, track_scene
from diethrow.files.scene import read_scene
from diethrow.model.laws import SmoothImpact
from diethrow.model.throw.motion import State, Throw
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.tracking.footage.photron import unpack_12bit
from diethrow.tracking.quality import QUALITIES

SIDE_PX, FOCAL_PX = 512, 2000.0
"""Size of the picture, and focal length: the cube is 100 px across."""
NOISE_GREY = 32.0
"""Standard deviation in levels of 12 bits: two grey levels of 8 bits."""
NOISES = 16
"""Number of noise pictures, which the frames use in turn, each time shifted at random."""
FILMED_S = 0.19
"""Filmed time, with three bounces, for any number of frames."""
MOST_HELD = 20_000
"""Largest number of frames that are decoded into memory: 10 GB."""
SAMPLED = 400
"""Frames over which unpacking and decoding are timed."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a row for each length and quality."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", nargs="+", type=int, default=[2000, 20000])
    parser.add_argument("--qualities", nargs="+", choices=QUALITIES, default=["standard"])
    parser.add_argument(
        "--folder", type=Path, help="where the clips are kept for later runs; without it they are deleted"
    )
    chosen = parser.parse_args(arguments)
    print(
        ROW.format("frames", "quality", "unpacked", "decoded", "tracked", "CPU", "MB", "before", "from mem.", "poses")
    )
    with tempfile.TemporaryDirectory() as scratch:
        for count in chosen.frames:
            folder = (chosen.folder or Path(scratch)) / f"{count}_frames"
            if not (folder / "scene.toml").exists():
                write_clip(folder, count)
            for quality in chosen.qualities:
                with multiprocessing.get_context("spawn").Pool(1) as pool:
                    print_row(quality, pool.apply(measure, (folder, quality)))
    return 0


ROW = "{:>6}  {:8}  {:>8}  {:>7}  {:>7}  {:>6}  {:>5}  {:>6}  {:>9}  {:>7}"


def print_row(quality: str, row: dict[str, float]) -> None:
    """One length at one quality."""
    rates = [f"{row[name]:.0f}" for name in ("unpacked", "decoded", "rate")]
    print(
        ROW.format(
            f"{row['frames']:.0f}", quality, *rates, f"{row['cpu_ms']:.3f}", f"{row['MB']:.0f}", f"{row['before']:.0f}",
            f"{row['held']:.0f}" if row["held"] else "-", f"{100 * row['tracked']:.1f} %",
        ),
        flush=True,
    )  # fmt: skip


def measure(folder: Path, quality: str) -> dict[str, float]:
    """Decode a part of the clip, track all of it, and write the tables."""
    scene = read_scene(folder / "scene.toml")
    clip = open_footage(scene, scene.views()[0])
    few = min(SAMPLED, len(clip))
    packed = np.frombuffer((folder / "clip.mraw").open("rb").read(SIDE_PX * SIDE_PX * 3 // 2), np.uint8)
    unpack_12bit(packed[:3])  # compiles
    _, unpacked_s = timed(lambda: [unpack_12bit(packed) for _ in range(few)], time.perf_counter)
    _, decoded_s = timed(lambda: [None for _ in clip.frames(0, few)], time.perf_counter)
    before = peak_MB()
    began, used = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as scratch:
        tracking = track_only(scene, Path(scratch) / "out", quality=QUALITIES[quality])
    taken_s, used_s = time.perf_counter() - began, time.process_time() - used
    most_MB, held = peak_MB(), 0.0
    if len(clip) <= MOST_HELD:
        pixels = np.empty((len(clip), clip.height_px, clip.width_px), np.uint16)
        for k, frame in enumerate(clip.frames()):
            pixels[k] = frame
        memory = DecodedClip(pixels, clip.times_s, clip.bit_depth)
        track_memory = partial(track_scene, scene, quality=QUALITIES[quality], clips=[memory])
        held = len(clip) / timed(track_memory, time.perf_counter)[1]
    return {
        "frames": len(clip),
        "unpacked": few / unpacked_s,
        "decoded": few / decoded_s,
        "rate": len(clip) / taken_s,
        "cpu_ms": 1e3 * used_s / len(clip),
        "MB": most_MB,
        "held": held,
        "before": before,
        "tracked": float(tracking.frames.tracked.mean()),
    }


class DecodedClip(ArrayClip):
    """A clip decoded into memory; a pass copies only the boxes that it reads."""

    in_any_order = True

    def fill(self, start: int, out: NDArray[Any], boxes: NDArray[np.int64] | None = None) -> None:
        """As `Footage.fill`."""
        if boxes is None:
            out[:] = self.array[start : start + len(out)]
            return
        for picture, there, (x0, y0, x1, y1) in zip(out, self.array[start:], boxes.tolist(), strict=False):
            picture[y0:y1, x0:x1] = there[y0:y1, x0:x1]


# --- the clip ---------------------------------------------------------------------------------------------------------


def write_clip(folder: Path, count: int) -> None:
    """A scene with its clip of `count` frames."""
    folder.mkdir(parents=True, exist_ok=True)
    room, throw = filmed_room(), filmed_throw()
    rate_hz = round(count / FILMED_S)
    write_photron(
        folder / "clip.cihx",
        np.zeros((1, SIDE_PX, SIDE_PX), np.uint16),
        stored_bits=12,
        record_rate_hz=rate_hz,
        shutter_hz=20 * rate_hz,
        declared_frames=count,
    )
    rng = np.random.default_rng(1)
    noises = rng.normal(scale=NOISE_GREY, size=(NOISES, SIDE_PX, SIDE_PX)).astype(np.float32)
    with (folder / "clip.mraw").open("wb") as file:
        for k in range(count):
            file.write(pack(frame(room, throw, k / rate_hz, noises[k % NOISES], rng), 12))
    cv2.imwrite(str(folder / "background.png"), np.rint(16.0 * room.table).astype(np.uint16))
    (folder / "scene.toml").write_text(scene_text(room))


def frame(
    room: Studio, throw: Throw, time_s: float, noise: NDArray[np.float32], rng: np.random.Generator
) -> NDArray[np.uint16]:
    """One frame of 12 bits with a shifted noise picture."""
    plain = photograph(room, CUBE, throw.at(time_s), spots=pips(CUBE))
    moved = np.roll(noise, tuple(rng.integers(0, SIDE_PX, 2)), (0, 1))
    return np.clip(np.rint(16.0 * plain + moved), 0, 4095).astype(np.uint16)


CUBE = DICE["cube"]


def filmed_room() -> Studio:
    """The camera of the tests with a larger picture, without motion blur."""
    return replace(studio(SIDE_PX, SIDE_PX, FOCAL_PX), noise_grey=NOISE_GREY / 16.0)


def filmed_throw() -> Throw:
    """A short fall with bounces, within the picture."""
    release = State(
        0.0, np.array([-0.004, 0.0, 0.04]), np.array([0.9, 0.3, 0.2, 0.25]) / np.linalg.norm([0.9, 0.3, 0.2, 0.25]),
        np.array([0.03, 0.02, -0.2]), np.array([9.0, -14.0, 6.0]),
    )  # fmt: skip
    return throw_die(CUBE, release, SmoothImpact(0.6), until=Until(impacts=4)).throw


def scene_text(room: Studio) -> str:
    """The scene file."""
    camera = room.camera
    rows = [
        "[clip]",
        'path = "clip.cihx"',
        'background = "background.png"',
        "fps_sigma = 0.0",
        "[camera]",
        f"width = {camera.width_px}",
        f"height = {camera.height_px}",
        f"matrix = {camera.matrix.tolist()}",
        f"distortion = {camera.distortion.tolist()}",
        f"rotation = {camera.rotation.tolist()}",
        f"translation_m = {camera.translation_m.tolist()}",
        'calibration = "exact"',
        "[table]",
        'surface = "matt"',
        "[die]",
        'shape = "cube"',
        f"edge_m = {CUBE.solid.edge_m}",
        "edge_sigma_m = 0.0",
        f"mass_kg = {CUBE.mass_kg}",
        'marks = "pips"',
    ]
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    sys.exit(main())
