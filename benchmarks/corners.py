"""How rounded dice look whose radius is known: `PYTHONPATH=tests/helpers python benchmarks/corners.py CLIP_FOLDER...`

A clip folder is as for `benchmarks/tracker.py`; its scene gives the true radius of the corners, or none for a sharp die. Each
clip is tracked as if its scene said nothing of them, and each rounded one also with the radius given and with a sharp die.

  radius     true radius [mm], and in pixels
  gain       by how much ℓ falls for corners of 1 px against sharp ones, and its standard error, of as many frames as were
             asked; above 0.02 and two standard errors the die is taken for rounded (`tracking/corners.py`)
  ms         that the question takes, on the threads that there are
  found      radius by the pictures [mm], with its standard error
  given, found, sharp: for each way to track it, median error of rotation [deg], across the picture [px] and along the line of
             sight [mm] of the smoothed poses; wrong: frames off by more than 5 degrees or 1 mm; bounces found of those that
             can be, + spurious ones
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

from accuracy import read_truth, truth_folder
from tracker import errors, print_rows

from diethrow.commands.clip.track import track_scene
from diethrow.files.scene import Scene, read_scene
from diethrow.tracking.clip_parameters import corner_radius
from diethrow.tracking.clip_parameters.corner_radius import ROUND_TESTED_PX, CornerRounding
from diethrow.tracking.picture.view import View
from diethrow.tracking.pose.frame_poses import SampledFrames
from diethrow.tracking.quality import FAST, STANDARD, Quality


def main(arguments: Sequence[str] | None = None) -> int:
    """Track the clips and print the tables."""
    parser = argparse.ArgumentParser(description="Compare the radius of dice's corners by the pictures with the truth.")
    parser.add_argument("clips", nargs="+", type=Path, metavar="CLIP_FOLDER")
    chosen = parser.parse_intermixed_args(arguments)
    looked: list[list[str]] = []
    tracked: list[list[str]] = []
    failures = 0
    for folder in chosen.clips:
        try:
            row, others = measured(folder)
        except (ValueError, OSError) as error:
            failures += 1
            print(f"{folder}: {error}", file=sys.stderr)
            continue
        looked.append(row)
        tracked += others
    print_rows(["clip", "radius", "gain", "ms", "found"], looked)
    if tracked:
        print()
        print_rows(["clip", "radius", "rotation", "across", "along", "wrong", "bounces"], tracked)
    return 1 if failures else 0


def measured(folder: Path) -> tuple[list[str], list[list[str]]]:
    """What the pictures of one clip say of the radius, and for a rounded die the accuracy with each radius."""
    scene, truth = read_scene(folder / "scene.toml"), read_truth(truth_folder(folder))
    true_m = scene.die.corner_radius_m
    sharp = replace(scene, die=replace(scene.die, corner_radius_m=0.0))
    name = folder.resolve().name
    asked: dict[str, Any] = {}
    with patch.object(corner_radius, "gain_of_rounding", noting(asked)):
        # Of a sharp die only the first pass tells anything here: the others go as if nobody had asked.
        found = tracked_as(replace(sharp, rounding=CornerRounding.TESTED), STANDARD if true_m else FAST)
    gain, sigma = asked["gain"]
    told = (
        "sharp" if found.corners is None else f"{1e3 * found.corners.radius_m:.3f} ± {1e3 * found.corners.sigma_m:.3f}"
    )
    radius = f"{1e3 * true_m:.2f} mm, {true_m * asked['px_per_m']:.1f} px"
    row = [name, radius, f"{gain:+.3f} ± {sigma:.3f}", f"{asked['ms']:.0f}", told]
    if not true_m:
        return row, []
    ways = {
        "given": tracked_as(replace(scene, rounding=CornerRounding.GIVEN), STANDARD),
        "found": found,
        "sharp": tracked_as(replace(sharp, rounding=CornerRounding.GIVEN), STANDARD),
    }
    return row, [[name, way, *accuracy(errors(scene, truth, ways[way]))] for way in ways]


def tracked_as(scene: Scene, quality: Quality) -> Any:
    """The whole of tracking."""
    return track_scene(scene, quality=quality)


def noting(asked: dict[str, Any]) -> Any:
    """`rounding_gain` that notes its last answer about the radius that is just noticed, and how long all of them took."""
    original = corner_radius.rounding_gain

    def noted(view: View, looks: SampledFrames, radius_px: float) -> tuple[float, float]:
        began = time.perf_counter()
        answer = original(view, looks, radius_px)
        asked["ms"] = asked.get("ms", 0.0) + 1e3 * (time.perf_counter() - began)
        if radius_px < ROUND_TESTED_PX or "gain" not in asked:
            asked["gain"] = answer
        asked.setdefault("px_per_m", corner_radius.scale_px_per_m(view, looks))
        return answer

    return noted


def accuracy(result: dict[str, Any]) -> list[str]:
    """The cells of a way to track a clip."""
    found, findable, spurious = result["bounces"]
    return [
        f"{result['rotation'][0]:.3f}",
        f"{result['px'][0]:.3f}",
        f"{result['depth'][0]:.2f}",
        str(result["wrong"]),
        f"{found} of {findable} + {spurious}",
    ]


if __name__ == "__main__":
    sys.exit(main())
