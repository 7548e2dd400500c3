"""The estimated corner radius of dice with known radius.

    PYTHONPATH=tests/helpers python benchmarks/corner_radii.py CLIP_FOLDER...

A clip folder is as for `benchmarks/tracker.py`; its scene gives the true corner radius, or none for a sharp die. Each
clip is tracked as if its scene did not state the radius, and each clip of a rounded die also with the radius given,
and as a sharp die.

  radius    true radius [mm], and in pixels
  surface   radius by the whole surface (`radius_by_surface`), the largest that costs no more, and whether the die is clearly
            rounded; none before a mirror, and where neither edges nor six frames show a radius, so that it is not asked
  ms        wall-clock time of `radius_by_surface`
  found     estimated radius [mm], with its standard error

  given, found, sharp: for each way to track it, median error of rotation [deg], across the line of sight [px] and along it
            [mm] of the smoothed poses; wrong: frames off by more than 5 degrees or 1 mm; impacts found of those that can
            be, + spurious
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
from population import radius_of
from tracker import errors, print_rows

from diethrow.commands.clip.track import track_scene
from diethrow.files.scene import read_scene
from diethrow.tracking.clip_parameters.corner_radius import CornerRounding
from diethrow.tracking.clip_parameters.radius_by_surface import SurfaceRadius
from diethrow.tracking.picture.view import View
from diethrow.tracking.pose.clip_poses import SampledFrames
from diethrow.tracking.quality import FAST, STANDARD
from diethrow.tracking.sequence import rounded_corners


def main(arguments: Sequence[str] | None = None) -> int:
    """Track the clips and print the tables."""
    parser = argparse.ArgumentParser(description="Compare estimated corner radii with the truth.")
    parser.add_argument("clips", nargs="+", type=Path, metavar="CLIP_FOLDER")
    chosen = parser.parse_intermixed_args(arguments)
    estimates: list[list[str]] = []
    accuracies: list[list[str]] = []
    failures = 0
    for folder in chosen.clips:
        try:
            row, others = measured(folder)
        except (ValueError, OSError) as error:
            failures += 1
            print(f"{folder}: {error}", file=sys.stderr)
            continue
        estimates.append(row)
        accuracies += others
    print_rows(["clip", "radius", "surface", "ms", "found"], estimates)
    if accuracies:
        print()
        print_rows(["clip", "tracked with", "rotation", "across", "along", "wrong", "impacts"], accuracies)
    return 1 if failures else 0


def measured(folder: Path) -> tuple[list[str], list[list[str]]]:
    """The estimated radius of one clip, and for a rounded die the accuracy of the track with each radius."""
    scene, truth = read_scene(folder / "scene.toml"), read_truth(truth_folder(folder))
    true_m = scene.die.corner_radius_m
    sharp = replace(scene, die=replace(scene.die, corner_radius_m=0.0))
    name = folder.resolve().name
    record: dict[str, Any] = {"surface": "none", "ms": 0.0}
    with patch.object(rounded_corners, "radius_by_surface", recording(record)):
        # For a sharp die the first pass suffices: the later ones do not depend on this test.
        found = track_scene(replace(sharp, rounding=CornerRounding.TESTED), quality=STANDARD if true_m else FAST)
    estimate = (
        "sharp" if found.corners is None else f"{1e3 * found.corners.radius_m:.3f} ± {1e3 * found.corners.sigma_m:.3f}"
    )
    scale = radius_of(scene, found)["px_per_mm"]
    radius = f"{1e3 * true_m:.2f} mm, {1e3 * true_m * scale:.1f} px"
    row = [name, radius, record["surface"], f"{record['ms']:.0f}", estimate]
    if not true_m:
        return row, []
    tracks = {
        "given": track_scene(replace(scene, rounding=CornerRounding.GIVEN), quality=STANDARD),
        "found": found,
        "sharp": track_scene(replace(sharp, rounding=CornerRounding.GIVEN), quality=STANDARD),
    }
    return row, [[name, radius_of, *accuracy(errors(scene, truth, track))] for radius_of, track in tracks.items()]


def recording(record: dict[str, Any]) -> Any:
    """`radius_by_surface` that records its first result, and its time."""
    original = rounded_corners.radius_by_surface

    def recorded(view: View, frames: SampledFrames) -> SurfaceRadius | None:
        began = time.perf_counter()
        found = original(view, frames)
        if found is not None and record["ms"] == 0.0:
            record["ms"] = 1e3 * (time.perf_counter() - began)
            rounded = ", rounded" if found.is_rounded else ""
            record["surface"] = f"{1e3 * found.best.radius_m:.2f}, at most {1e3 * found.most_m:.2f} mm{rounded}"
        return found

    return recorded


def accuracy(result: dict[str, Any]) -> list[str]:
    """The cells for one way to track a clip."""
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
