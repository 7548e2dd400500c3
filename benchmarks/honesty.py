"""Are covariances and intervals as large as the errors? `python benchmarks/honesty.py [--seed 1 ...] [--label main]`.

Sums up what `benchmarks/population.py` has measured, once with exact calibrations stated as such, and once with calibrations off
by draws from what is stated (`--calibration drawn`). A clip whose track failed, with a frame off by more than 5 degrees or 1 mm
across, is counted apart: no covariance is meant to hold a die that was lost. A row for each kind of clip; each figure with its
standard error over clips, since one clip has only some five independent errors.

  clips      analysed, and of these those whose track failed
  NEES       mean over clips of each clip's mean; 6 where covariances are honest
  within     frames inside the 95 % ellipsoid [%]
  chi        rms of the error over its standard error; 1 where intervals are honest
  holds      95 % intervals that hold the truth [%]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from population import DEFAULT_CACHE, read_results, results_path

from diethrow.tracking.quality import QUALITIES

Array = NDArray[np.float64]

DRAWS = 1000
"""Random sets of clips behind each standard error."""
SEED = 26


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables. The exit status is 1 where there is nothing to sum up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--seed", type=int, nargs="+", default=[1], help="of the clips; of several, all are counted (1)"
    )
    parser.add_argument("--cache", type=Path, default=DEFAULT_CACHE, help="folder of clips and results (%(default)s)")
    parser.add_argument("--label", default="main", help="name of the results (%(default)s)")
    parser.add_argument("--quality", choices=list(QUALITIES), default="standard")
    chosen = parser.parse_args(arguments)
    shown = False
    for calibration in ("exact", "drawn"):
        paths = [results_path(chosen.cache, seed, chosen.label, chosen.quality, calibration) for seed in chosen.seed]
        known = (one for path in paths for one in read_results(path).values())
        results = [one for one in known if one["outcome"] == "analysed" and "nees_mean" in one]
        if results:
            print(f"\ncalibration {calibration}")
            print_table(results)
            shown = True
    if not shown:
        print(
            f"no results of seed {' '.join(map(str, chosen.seed))}, label {chosen.label}: run benchmarks/population.py",
            file=sys.stderr,
        )
    return 0 if shown else 1


def print_table(results: Sequence[dict[str, Any]]) -> None:
    """A row for all clips and one for each kind."""
    kinds = sorted({kind for result in results for kind in result["kinds"]})
    heads = ["kind", "clips", "failed", "NEES", "within", "chi", "holds", "of"]
    rows = [row_of("all", results)]
    rows += [row_of(kind, [result for result in results if kind in result["kinds"]]) for kind in kinds]
    widths = [max(len(row[k]) for row in (heads, *rows)) for k in range(len(heads))]
    for row in (heads, *rows):
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def row_of(kind: str, results: Sequence[dict[str, Any]]) -> list[str]:
    """The cells of one kind."""
    good = [result for result in results if result["gross"] == 0]
    nees, within = (np.array([result[name] for result in good]) for name in ("nees_mean", "within"))
    sigmas = np.array([one["chi"]["sigmas"] for one in good if one["chi"]["sigmas"] is not None])
    holds = np.array([float(one["chi"]["holds"]) for one in good if one["chi"]["holds"] is not None])
    return [
        kind,
        str(len(results)),
        str(len(results) - len(good)),
        with_error(nees, np.mean, 1),
        with_error(100.0 * within, np.mean, 0),
        with_error(sigmas, lambda values: np.sqrt(np.mean(values**2)), 2),
        with_error(100.0 * holds, np.mean, 0),
        str(len(holds)),
    ]


def with_error(values: Array, statistic: Any, digits: int) -> str:
    """A statistic of a value a clip, with its standard error over random sets of as many clips."""
    if len(values) < 2:
        return ""
    rng = np.random.default_rng(SEED)
    drawn = [statistic(values[rng.integers(0, len(values), len(values))]) for _ in range(DRAWS)]
    return f"{statistic(values):.{digits}f} ± {np.std(drawn):.{digits}f}"


if __name__ == "__main__":
    sys.exit(main())
