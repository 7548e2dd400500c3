"""Keep the numbers of one version of the program, and compare another version's with them.

    python benchmarks/same_numbers.py keep OLD [--scenes SCENE...] [--tosses DATA]
    python benchmarks/same_numbers.py keep NEW [--scenes SCENE...] [--tosses DATA]
    python benchmarks/same_numbers.py compare OLD NEW [--within-sigma 0.01]

`keep` runs the `diethrow` command that is installed beside this Python: `analyze` on the sample clip and on every SCENE, one
simulated throw without and one with friction, the odds of 2000 throws, basins, exponents, and, where DATA holds `scene.toml` and
`toss_*.csv`, the joint fit of 40 tosses. `compare` prints every file that is the same byte by byte and, of every other, the
column that differs most: as a share of the largest number in the column, and in standard errors where the files state them
(sigma columns of tables, intervals of `fit.json`). The exit status is 1 if a discrete result differs, or any number by more
than `--within-sigma` standard errors; a number without a standard error may differ by 1e-6 of its column's largest.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

SAMPLE = Path(__file__).parents[1] / "data_samples" / "cube_wood" / "scene.toml"

TOSSES = 40
"""Tosses in the joint fit, evenly spread over those there are."""

RELATIVE = 1e-6
"""Largest difference of a number without a standard error, as a share of its column's largest: rounding, summed up."""

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

TABLES = (".csv", ".json", ".npy", ".npz", ".toml")
NOT_COMPARED = ("provenance.json",)
"""Holds times and the command line."""


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
    """Run every command, each into a folder of its own."""
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
    """One command, with the time that it took."""
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
    """Print what differs, and return whether all of it is within what is allowed."""
    names = sorted(
        {str(path.relative_to(folder)) for folder in (old, new) for path in folder.rglob("*") if compared(path)}
    )
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


def compared(path: Path) -> bool:
    return path.is_file() and path.suffix in TABLES and path.name not in NOT_COMPARED


def report(name: str, old: dict[str, list[Any]], new: dict[str, list[Any]], within_sigma: float) -> bool:
    """A line for every column that differs; whether all of them may."""
    good = True
    for column in dict.fromkeys([*old, *new]):
        was, now = old.get(column, []), new.get(column, [])
        if was == now:
            continue
        verdict, allowed = difference(column, was, now, old, within_sigma)
        if verdict:
            print(f"{name}: {column}: {verdict}{'' if allowed else '  <-- too much'}")
        good &= allowed
    return good


def difference(
    column: str, was: list[Any], now: list[Any], table: dict[str, list[Any]], limit: float
) -> tuple[str, bool]:
    """How two columns differ, in words, and whether they may."""
    if len(was) != len(now):
        return f"{len(was)} values were, {len(now)} are", False
    discrete = [(a, b) for a, b in zip(was, now, strict=True) if str(a) != str(b) and None in (number(a), number(b))]
    if discrete:
        text = column.startswith(("messages", "evidence")) or "messages" in column or "why" in column
        return f"{len(discrete)} of {len(was)} differ, first {discrete[0][0]!r} -> {discrete[0][1]!r}", text
    a = np.array([math.nan if number(v) is None else number(v) for v in was], dtype=float)
    b = np.array([math.nan if number(v) is None else number(v) for v in now], dtype=float)
    gap = np.abs(b - a)
    if not np.nanmax(gap, initial=0.0):
        return "", True
    share = float(np.nanmax(gap) / max(np.nanmax(np.abs(a)), 1e-300))
    sigma = sigma_of(column, table, len(was))
    if sigma is None:
        return f"{share:.1e} of the largest", share <= RELATIVE
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = float(np.nanmax(np.where(gap > 0, gap / sigma, 0.0)))
    return f"{share:.1e} of the largest, {sigmas:.1e} standard errors", sigmas <= limit or share <= RELATIVE


def sigma_of(column: str, table: dict[str, list[Any]], rows: int) -> np.ndarray | None:
    """The standard errors that a file states for a column, None where it states none."""
    rotation = column in ("qw", "qx", "qy", "qz")
    for stated in (f"sigma_{column}", f"{column}_sigma", *(["sigma_rx_rad"] if rotation else [])):
        if stated in table and len(table[stated]) == rows:
            return np.array([math.nan if number(v) is None else number(v) for v in table[stated]], dtype=float)
    root = (
        column.removesuffix(".value")
        .removesuffix("_low")
        .removesuffix("_high")
        .removesuffix(".low")
        .removesuffix(".high")
    )
    for low, high in ((f"{root}.low", f"{root}.high"), (f"{root}_low", f"{root}_high")):
        if low in table and high in table and len(table[low]) == rows:
            ends = [[math.nan if number(v) is None else number(v) for v in table[end]] for end in (low, high)]
            return np.subtract(ends[1], ends[0]) / (2 * NORMAL_QUANTILE)
    return None


def columns_of(path: Path) -> dict[str, list[Any]]:
    """The columns of a table, the arrays of a file, or the values of JSON by their path of keys."""
    if path.suffix == ".csv":
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        return {name: [row[k] for row in rows[1:]] for k, name in enumerate(rows[0])}
    if path.suffix == ".json":
        columns: dict[str, list[Any]] = {}
        for name, value in leaves(json.loads(path.read_text(encoding="utf-8"))):
            columns.setdefault(name, []).append(value)
        return columns
    if path.suffix == ".npy":
        return {"array": np.load(path, allow_pickle=False).ravel().tolist()}
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            return {name: arrays[name].ravel().tolist() for name in arrays.files}
    return {"text": list(path.read_text(encoding="utf-8").splitlines())}


def leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of nested tables with its path of keys; the items of a list share a path."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from leaves(part, f"{name}.{key}" if name else key)
    elif isinstance(value, list):
        for part in value:
            yield from leaves(part, name)
    else:
        yield name, value


def number(value: Any) -> float | None:
    """A finite number; None for anything else, truth values among it."""
    if value is None or isinstance(value, bool):
        return None
    try:
        found = float(value)
    except (TypeError, ValueError):
        return None
    return found if math.isfinite(found) else None


if __name__ == "__main__":
    main()
