"""How long a person waits: whole commands on the short sample, from the command line to the last file.

    python benchmarks/seconds.py                  # the median of five rounds
    python benchmarks/seconds.py --rounds 1       # a glance

Everything is compiled before the first round. In each round every command runs once, beside a fixed reference job (sums in
plain Python, about a second): on a busy or another machine the ratio to it says more than the seconds. Then follows the time line
of the last analysis: each stage of each thread, with its processor time. The machine should be idle; its load is printed.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

SAMPLES = Path(__file__).parents[1] / "data_samples"
SCENE = SAMPLES / "cube_wood" / "scene.toml"
REFERENCE = [sys.executable, "-c", "sum(k * k % 7 for k in range(10_000_000))"]


def commands(out: Path) -> dict[str, Sequence[str | Path]]:
    """Every command by its name in the table. The first one makes what `fit` and `predict` read."""
    analysed = out / "analyze"
    return {
        "analyze": ("analyze", SCENE, "--out", analysed),
        "analyze --quality fast": ("analyze", SCENE, "--quality", "fast", "--out", out / "fast"),
        "  ... --every 4 --shrink 2": (
            *("analyze", SCENE, "--quality", "fast", "--every", "4", "--shrink", "2"),
            *("--out", out / "fewer"),
        ),
        "fit": ("fit", analysed / "track_frames.csv", "--scene", SCENE, "--out", out / "fit"),
        "predict": (
            *("predict", analysed / "track_frames.csv", "--scene", SCENE, "--fit", analysed / "fit.json"),
            *("--out", out / "predicted.csv"),
        ),
        "throw": ("throw", SAMPLES / "throws" / "cube_mirror.toml", "--out", out / "throw"),
        "odds, 1000 throws": ("odds", "--throws", "1000", "--out", out / "odds"),
        "basins, 100 x 100": ("basins", "--pixels", "100", "100", "--out", out / "basins"),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    print(f"{len(os.sched_getaffinity(0))} cores, load before {os.getloadavg()[0]:.2f}; median of {options.rounds}")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        jobs = commands(out)
        for words in jobs.values():
            _run(words)
        seconds: dict[str, list[float]] = {name: [] for name in jobs}
        processor: dict[str, list[float]] = {name: [] for name in jobs}
        reference = []
        for _ in range(options.rounds):
            reference.append(_timed(REFERENCE)[0])
            for name, words in jobs.items():
                wall, cpu = _run(words)
                seconds[name].append(wall)
                processor[name].append(cpu)
        print(f"{'':28} seconds  processor  reference jobs")
        for name in jobs:
            ratio = float(np.median(np.divide(seconds[name], reference)))
            print(f"{name:28} {np.median(seconds[name]):7.2f} {np.median(processor[name]):10.2f} {ratio:15.2f}")
        print(f"{'reference job':28} {np.median(reference):7.2f}")
        print("\ntime line of the last `analyze`")
        for row in json.loads((out / "analyze" / "provenance.json").read_text())["time_line"]:
            end = row["start_s"] + row["wall_s"]
            print(
                f"  {row['start_s']:6.2f} to {end:6.2f} s  {row['thread']:8} {row['stage']:10} "
                f"processor {row['processor_s']:.2f} s"
            )


def _run(words: Sequence[str | Path]) -> tuple[float, float]:
    """Wall and processor time [s] of a command of the program, whose output is new."""
    out = Path(words[-1])
    shutil.rmtree(out, ignore_errors=True)
    for file in out.parent.glob(f"{out.stem}*"):
        if file.is_file():
            file.unlink()
    program = "import sys; from diethrow.cli import main; sys.argv[0] = 'diethrow'; main()"
    return _timed([sys.executable, "-c", program, *map(str, words)])


def _timed(words: Sequence[str]) -> tuple[float, float]:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    wall = time.perf_counter() - began
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}\n{done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    main()
