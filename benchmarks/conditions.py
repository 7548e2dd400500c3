"""Which camera, which light, which die? `python benchmarks/conditions.py [--seed 31] [--cache FOLDER]`.

Sums up what `benchmarks/population.py` has measured by the conditions of each clip: size of the die in the picture, frame rate,
motion blur, corners, gloss, paint, marks, response, shutter, codec. Conditions are drawn independently of each other, so that a
row differs from the next by its own condition and by chance. (A rolling shutter comes with low rates alone, and spins are lower
there.) Columns:

  clips      analysed
  flawless   no frame off by more than 5 degrees or 1 mm across, every lone bounce found, none spurious; 95 % interval (Wilson)
  tracked    frames with a pose, of those that show the whole die
  rotation, lateral, depth   medians over clips of each clip's median error [deg, mm, mm]
  chi        median over clips of the absolute error of the restitution coefficient
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from measuring import write_table
from population import DEFAULT_CACHE, read_results, results_path
from population_clips import Draw, draw_clip
from scipy.stats import binomtest

from diethrow.model.die import SHAPES
from diethrow.tracking.quality import QUALITIES

Condition = tuple[str, Callable[[Draw], bool]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table. The exit status is 1 where there is nothing to sum up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=31, help="(%(default)s)")
    parser.add_argument("--cache", type=Path, default=DEFAULT_CACHE, help="folder of clips and results (%(default)s)")
    parser.add_argument("--label", default="main", help="name of the results (%(default)s)")
    parser.add_argument("--quality", choices=list(QUALITIES), default="standard")
    parser.add_argument("--page", type=Path, help="write the table into this page, between its marks")
    chosen = parser.parse_args(arguments)
    path = results_path(chosen.cache, chosen.seed, chosen.label, chosen.quality, "exact")
    results = [one for one in read_results(path).values() if one["outcome"] == "analysed" and "nees" in one]
    if not results:
        print(f"no results of seed {chosen.seed}, label {chosen.label}: run benchmarks/population.py", file=sys.stderr)
        return 1
    draws = {one["clip"]: draw_clip(chosen.seed, one["clip"]) for one in results}
    heads = ["condition", "clips", "flawless", "frames tracked", "rotation °", "lateral mm", "depth mm", "χ"]
    rows = [row_of("all", results)]
    for name, holds in CONDITIONS:
        chosen_results = [one for one in results if holds(draws[one["clip"]])]
        rows += [row_of(name, chosen_results)] if chosen_results else []
    widths = [max(len(row[k]) for row in (heads, *rows)) for k in range(len(heads))]
    for row in (heads, *rows):
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    if chosen.page:
        write_table(chosen.page, Path(__file__).name, heads, rows)
    return 0


def size_px(draw: Draw) -> float:
    """Median over the frames of the diameter of the die's circumscribed sphere in the picture."""
    positions = draw.throw.poses(np.arange(draw.frames) / draw.fps)[0]
    depth = (positions - draw.camera.centre_m) @ draw.camera.rotation[2]
    return float(np.median(2.0 * draw.camera.matrix[0, 0] * draw.die.solid.circumradius / depth))


def step_px(draw: Draw) -> float:
    """Median over the frames of how far the centre of the die moves in the picture from one to the next."""
    pixels = draw.camera.project(draw.throw.poses(np.arange(draw.frames) / draw.fps)[0])
    return float(np.nanmedian(np.linalg.norm(np.diff(pixels, axis=0), axis=1)))


def blur_px(draw: Draw) -> float:
    """How far it moves during the exposure."""
    return step_px(draw) * draw.exposure_s * draw.fps


def radius_share(draw: Draw) -> float:
    """Radius of the corners in edges."""
    return draw.die.corner_radius_m / draw.die.solid.edge_m


def _between(name: str, value: Callable[[Draw], float], limits: Sequence[float], unit: str) -> list[Condition]:
    """One condition for each range between neighbouring limits."""

    def within(low: float, high: float) -> Condition:
        label = f"{name} {low:g} to {high:g}{unit}" if np.isfinite(high) else f"{name} over {low:g}{unit}"
        return label, lambda draw: low <= value(draw) < high

    return [within(low, high) for low, high in pairwise(limits)]


def _of_shape(shape: str) -> Condition:
    return shape, lambda draw: draw.die.solid.name == shape


CONDITIONS: list[Condition] = [
    *_between("die across", size_px, (40, 60, 90, 160), " px"),
    *_between("rate", lambda draw: draw.fps, (240, 500, 1500, 5001), " frames/s"),
    *_between("motion from frame to frame", step_px, (0, 2, 5, np.inf), " px"),
    *_between("motion in the exposure", blur_px, (0, 0.3, 1, np.inf), " px"),
    ("sharp corners", lambda draw: radius_share(draw) == 0.0),
    ("corners up to 5 % of the edge", lambda draw: 0.0 < radius_share(draw) < 0.05),
    ("corners of 5 to 15 %", lambda draw: radius_share(draw) >= 0.05),
    ("matt", lambda draw: draw.gloss == 0.0),
    ("glossy", lambda draw: draw.gloss > 0.0),
    ("light paint", lambda draw: draw.albedo > 0.35),
    ("dark paint", lambda draw: draw.albedo <= 0.35),
    ("marks on the faces", lambda draw: bool(draw.die.marks)),
    ("plain faces", lambda draw: not draw.die.marks),
    ("linear grey levels", lambda draw: draw.response == "linear"),
    ("display curve, stated", lambda draw: draw.states_response),
    ("display curve, not stated", lambda draw: draw.response != "linear" and not draw.states_response),
    ("global shutter", lambda draw: draw.readout_s == 0.0),
    ("rolling shutter", lambda draw: draw.readout_s > 0.0),
    ("lossless", lambda draw: draw.codec == "ffv1"),
    ("MJPEG", lambda draw: draw.codec == "mjpeg"),
    ("H.264", lambda draw: draw.codec == "h264"),
    ("HEVC", lambda draw: draw.codec == "hevc"),
    *map(_of_shape, SHAPES),
]


def row_of(name: str, results: Sequence[dict[str, Any]]) -> list[str]:
    """The cells of one condition."""
    flawless = sum(one["gross"] == 0 and one["found"] == one["lone"] and one["spurious"] == 0 for one in results)
    share = binomtest(flawless, len(results)).proportion_ci(method="wilson")
    tracked = sum(one["tracked"] for one in results) / sum(one["visible"] for one in results)
    errors = [
        float(np.median([one[kind][0] for one in results if one[kind]])) for kind in ("rotation", "lateral", "depth")
    ]
    chi = [abs(one["chi"]["error"]) for one in results if one["chi"]["error"] is not None]
    return [
        name,
        str(len(results)),
        f"{100.0 * flawless / len(results):.0f} % ({100.0 * share.low:.0f} to {100.0 * share.high:.0f})",
        f"{100.0 * tracked:.1f} %",
        *(f"{error:.2g}" for error in errors),
        f"{np.median(chi):.1g}" if chi else "",
    ]


if __name__ == "__main__":
    sys.exit(main())
