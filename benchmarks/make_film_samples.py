"""Render the throws in data_samples/throws as clips small enough for the repository.

    PYTHONPATH=tests/helpers python benchmarks/make_film_samples.py data_samples tests/data [NAME...] [--variant llvm_ad_mono]

Each clip is the output of `diethrow film data_samples/throws/NAME.toml` with the settings of `FILMS`, encoded as monochrome
H.264 like the other sample (`make_data_samples`), with its truth in tests/data/NAME. Needs Mitsuba, and some minutes a clip.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from footage_files import write_video
from make_data_samples import X264

from diethrow.commands.model.filmed_throw import FilmSettings, film
from diethrow.files.plan import read_plan
from diethrow.tracking.footage.clip import open_clip

FPS = 1500.0
FILMS = {
    "cube_mirror": FilmSettings(frames=170, start_s=0.31, size_px=384, exposure_s=1e-4, seed=5),
    "icosahedron_cork": FilmSettings(frames=170, start_s=0.312, size_px=384, exposure_s=1e-4, seed=6),
    "tetrahedron_wood": FilmSettings(frames=170, start_s=0.07, size_px=384, exposure_s=2e-4, seed=7),
}
"""A die that falls from 60 cm is in view for the last 30 ms of its fall; the rest is left out."""
MAX_BYTES = 3_000_000
"""Size of a clip that a clone of the repository bears."""
BACKGROUND_BYTES = 200_000
"""Of them, for the background."""
CRF_STEPS = (1.0, 1.6, 2.5, 4.0)
"""Added to x264's crf, one after the other, until the clip is small enough."""
TRUTH = ("truth.csv", "bounces.csv", "truth.toml", "vertices.csv", "faces.csv")


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the named samples, and print the error of their encoding."""
    parser = argparse.ArgumentParser(description="Film the throws in data_samples/throws.")
    parser.add_argument("samples", type=Path)
    parser.add_argument("truths", type=Path)
    parser.add_argument("names", nargs="*", default=list(FILMS), metavar="NAME")
    parser.add_argument("--variant", default="scalar_rgb")
    chosen = parser.parse_intermixed_args(arguments)
    for name in chosen.names:
        make_sample(chosen.samples, chosen.truths / name, name, chosen.variant)
    return 0


def make_sample(samples: Path, truth: Path, name: str, variant: str) -> None:
    """One sample: render, encode, and write scene, background and truth next to it."""
    folder = samples / name
    with tempfile.TemporaryDirectory() as scratch:
        whole = Path(scratch) / name
        settings = FILMS[name]
        film(read_plan(samples / "throws" / f"{name}.toml"), whole, settings=settings_with(settings, variant))
        frames = np.stack(list(open_clip(whole / "clip.avi", fps=FPS).frames()))
        folder.mkdir(parents=True, exist_ok=True)
        truth.mkdir(parents=True, exist_ok=True)
        bytes_ = code(folder / "clip.mp4", frames)
        (folder / "scene.toml").write_text((whole / "scene.toml").read_text().replace("clip.avi", "clip.mp4"))
        shutil.copyfile(whole / "background.png", folder / "background.png")
        for file in TRUTH:
            shutil.copyfile(whole / file, truth / file)
    coded = np.stack(list(open_clip(folder / "clip.mp4", fps=FPS).frames()))
    error = coded.astype(int) - frames
    print(f"{name}: {bytes_ / 1e6:.2f} MB, coding bias {error.mean():+.3f}, rms {error.std():.2f} grey levels")


def settings_with(settings: FilmSettings, variant: str) -> FilmSettings:
    """The settings on another of Mitsuba's variants: the same light with other noise."""
    return replace(settings, variant=variant)


def code(path: Path, frames: np.ndarray) -> int:
    """Write the clip at the highest quality that fits, and return its size in bytes."""
    for step in (0.0, *CRF_STEPS):
        options = X264 | {"crf": str(float(X264["crf"]) + step)}
        write_video(path, frames, codec="libx264", pixels="gray", fps=int(FPS), options=options)
        if path.stat().st_size <= MAX_BYTES - BACKGROUND_BYTES:
            break
    return path.stat().st_size


if __name__ == "__main__":
    sys.exit(main())
