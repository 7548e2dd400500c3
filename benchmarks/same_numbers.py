"""Keep the numbers of one version of the program, and compare those of another version with them.

    python benchmarks/same_numbers.py keep OLD [--scenes SCENE...] [--tosses DATA]
    python benchmarks/same_numbers.py keep NEW [--scenes SCENE...] [--tosses DATA]
    python benchmarks/same_numbers.py compare OLD NEW [--within-sigma 0.01]

`keep` runs the `diethrow` command that is installed beside this Python: `analyze` on the sample clip and on every SCENE, one
simulated throw without and one with friction, the odds of 2000 throws, basins and exponents. If DATA contains `scene.toml`
and `toss_*.csv`, it also runs the joint fit of 40 tosses. `compare` prints the columns that differ: as a share of the largest
number in the column, and in standard errors if the files state them (sigma columns of tables, intervals of `fit.json`). The
exit status is 1 if a discrete result differs, or any number by more than `--within-sigma` standard errors. A number without
a standard error may differ by 1e-6 of the largest number in its column.
"""

from __future__ import annotations

import argparse
import math
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from diethrow.commands.results.folder_comparison import columns_of, compared_files, finite_number

SAMPLE = Path(__file__).parents[1] / "data_samples" / "cube_wood" / "scene.toml"

TOSSES = 40
"""Tosses in the joint fit, evenly spread over the data."""

RELATIVE = 1e-6
"""Largest difference of a number without a standard error, as a share of its column's largest: accumulated rounding."""

NORMAL_QUANTILE = 1.959964
"""A 95 % interval is this many standard errors to each side."""

THROW = """
[die]
shape = "{shape}"
edge_m = 0.02
mass_kg = 0.016
[law]
chi = 0.5
{friction}
[initial]
position_m = [0.0, 0.0, 0.3]
euler_rad = [0.3, 1.2, 0.6]
velocity_m_s = [0.6, 0.0, -0.7]
omega_body_rad_s = [3.0, 40.0, 2.0]
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    keep_parser = commands.add_parser("keep")
    keep_parser.add_argument("folder", type=Path)
    keep_parser.add_argument("--scenes", type=Path, nargs="*", default=[])
    keep_parser.add_argument("--tosses", type=Path, default=None)
    compare_parser = commands.add_parser("compare")
    compare_parser.add_argument("old", type=Path)
    compare_parser.add_argument("new", type=Path)
    compare_parser.add_argument("--within-sigma", type=float, default=0.01)
    options = parser.parse_args()
    if options.command == "keep":
        keep(options.folder, options.scenes, options.tosses)
    else:
        sys.exit(0 if compare(options.old, options.new, options.within_sigma) else 1)


# --- keep ---


def keep(folder: Path, scenes: list[Path], tosses: Path | None) -> None:
    """Run every command, each into its own folder."""
    folder.mkdir(parents=True)
    for scene in [SAMPLE, *scenes]:
        run("analyze", scene, "--out", folder / f"analyze_{scene.parent.name}")
    for name, shape, friction in (("smooth", "cube", ""), ("friction", "icosahedron", "mu = 0.2")):
        plan = folder / f"{name}.toml"
        plan.write_text(THROW.format(shape=shape, friction=friction))
        run("throw", plan, "--out", folder / f"throw_{name}")
    run("odds", "--throws", "2000", "--seed", "7", "--out", folder / "odds")
    run("odds", "--throws", "2000", "--seed", "7", "--mu", "0.2", "--out", folder / "odds_friction")
    run("basins", "--chi", "0.2", "--pixels", "40", "40", "--out", folder / "basins")
    run("lyapunov", "--orbits", "2", "--impacts", "600", "--out", folder / "lyapunov")
    if tosses is not None:
        paths = sorted(tosses.glob("toss_*.csv"))
        chosen = [paths[k] for k in np.linspace(0, len(paths) - 1, TOSSES).round().astype(int)]
        run("fit", *chosen, "--scene", tosses / "scene.toml", "--out", folder / "joint_fit")
        run("predict", chosen[0], "--scene", tosses / "scene.toml", "--fit", folder / "joint_fit" / "fit.json",
            "--from-frame", "first-bounce", "--out", folder / "predicted.csv")  # fmt: skip


def run(*words: str | Path) -> None:
    """Run one command and print its duration."""
    program = shutil.which("diethrow", path=str(Path(sys.executable).parent))
    if program is None:
        raise FileNotFoundError(
            f"no diethrow command beside {sys.executable}; install the package into this environment"
        )
    begin = time.perf_counter()
    subprocess.run([program, *map(str, words)], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    print(f"{time.perf_counter() - begin:7.1f} s  {words[0]} {Path(words[-1]).name}", flush=True)


# --- compare ---


def compare(old: Path, new: Path, within_sigma: float) -> bool:
    """Print all differences, and return whether they are within the limits."""
    names = compared_files(old, new)
    same, good = 0, True
    for name in names:
        paths = old / name, new / name
        if not all(path.is_file() for path in paths):
            print(f"{name}: only in {old if paths[0].is_file() else new}")
            good = False
        elif paths[0].read_bytes() == paths[1].read_bytes():
            same += 1
        else:
            good &= report(name, columns_of(paths[0]), columns_of(paths[1]), within_sigma)
    print(
        f"{same} of {len(names)} files are the same byte by byte; {'all within the limits' if good else 'NOT within the limits'}"
    )
    return good


def report(name: str, old: dict[str, list[Any]], new: dict[str, list[Any]], within_sigma: float) -> bool:
    """Print a line for every column that differs, and return whether all are within the limits."""
    good = True
    for column in dict.fromkeys([*old, *new]):
        was, now = old.get(column, []), new.get(column, [])
        if was == now:
            continue
        verdict, allowed = difference(name, column, was, now, old, within_sigma)
        if verdict:
            print(f"{name}: {column}: {verdict}{'' if allowed else '  <-- too much'}")
        good &= allowed
    return good


def difference(
    name: str, column: str, was: list[Any], now: list[Any], table: dict[str, list[Any]], limit: float
) -> tuple[str, bool]:
    """The difference of two columns as text, and whether it is within the limits. Reworded messages are."""
    if len(was) != len(now):
        return f"{len(was)} values were, {len(now)} are", False
    discrete = [
        (a, b)
        for a, b in zip(was, now, strict=True)
        if str(a) != str(b) and None in (finite_number(a), finite_number(b))
    ]
    if discrete:
        text = column.startswith(("messages", "evidence")) or "messages" in column or "why" in column
        return f"{len(discrete)} of {len(was)} differ, first {discrete[0][0]!r} -> {discrete[0][1]!r}", text
    a, b = as_numbers(was), as_numbers(now)
    gap = np.abs(b - a)
    if not np.nanmax(gap, initial=0.0):
        return "", True
    share = float(np.nanmax(gap) / max(np.nanmax(np.abs(a)), 1e-300))
    if column.startswith("sigma_") or "covariance" in name + column:
        return f"{share:.1e} of the largest standard error", share <= limit
    sigma = sigma_of(column, table, len(was))
    if sigma is None or np.isnan(sigma).all():
        return f"{share:.1e} of the largest", share <= RELATIVE
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = float(np.nanmax(np.where(gap > 0, gap / sigma, 0.0)))
    return f"{share:.1e} of the largest, {sigmas:.1e} standard errors", sigmas <= limit or share <= RELATIVE


def sigma_of(column: str, table: dict[str, list[Any]], rows: int) -> np.ndarray | None:
    """The standard errors that a file states for a column; None if it states none."""
    rotation = column in ("qw", "qx", "qy", "qz")
    for stated in (f"sigma_{column}", f"{column}_sigma", *(["sigma_rx_rad"] if rotation else [])):
        if stated in table and len(table[stated]) == rows:
            return as_numbers(table[stated])
    root = column
    for suffix in (".value", "_low", "_high", ".low", ".high"):
        root = root.removesuffix(suffix)
    for low, high in ((f"{root}.low", f"{root}.high"), (f"{root}_low", f"{root}_high")):
        if low in table and high in table and len(table[low]) == rows:
            return (as_numbers(table[high]) - as_numbers(table[low])) / (2 * NORMAL_QUANTILE)
    return None


def as_numbers(values: list[Any]) -> np.ndarray:
    """The values as numbers; NaN for all others."""
    return np.array([math.nan if (number := finite_number(v)) is None else number for v in values], dtype=float)


if __name__ == "__main__":
    main()
