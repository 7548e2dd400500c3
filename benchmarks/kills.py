"""`kill -9` of a batch and of its workers at random moments.

    python benchmarks/kills.py --kills 200 --clips 6

Runs `diethrow batch` over copies of the short sample, kills the batch or one of its workers at a random moment, examines the
folder, and continues, until the wanted number of kills; a finished batch is repeated in another folder. Nothing incomplete may
look finished, no finished clip may be analysed again, and every number must equal that of an undisturbed batch.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

SAMPLE = Path(__file__).parents[1] / "data_samples" / "cube_wood_photron"
SLOWEST_S = 60.0
"""Of a whole batch, as far as the moments of the kills are drawn over it: a busy machine must not make them rare."""
TABLES = ("track.csv", "track_frames.csv", "bounces.csv", "faces.csv", "vertices.csv", "track_covariance.npy")


def main() -> int:
    """Kill, examine, and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--clips", type=int, default=6)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    random = np.random.default_rng(options.seed)
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        scenes = [shutil.copytree(SAMPLE, root / f"clip_{k}") / "scene.toml" for k in range(options.clips)]
        begin = time.monotonic()
        subprocess.run(batch(scenes, root / "whole", options.workers), check=True, capture_output=True)
        whole_s = min(time.monotonic() - begin, SLOWEST_S)
        tally = dict.fromkeys(("batches killed", "workers killed", "batches done", "clips done", "faults"), 0)
        made = 0
        while made < options.kills:
            made += one_batch(scenes, root, options.kills - made, options.workers, whole_s, random, tally)
            shutil.rmtree(root / "out")
            print(f"{made} kills, a whole batch takes {whole_s:.0f} s: {tally}", flush=True)
    return 1 if tally["faults"] else 0


def batch(scenes: list[Path], out: Path, workers: int) -> list[str]:
    """The command."""
    words = [sys.executable, "-m", "diethrow", "batch", *map(str, scenes), "--out", str(out)]
    return [*words, "--only-track", "--quality", "fast", "--workers", str(workers)]


def one_batch(
    scenes: list[Path],
    root: Path,
    most: int,
    workers: int,
    whole_s: float,
    random: np.random.Generator,
    tally: dict[str, int],
) -> int:
    """Restart a batch until it finishes; returns the number of kills."""
    out, kills = root / "out", 0
    finished: dict[str, int] = {}
    while True:
        with subprocess.Popen(
            batch(scenes, out, workers), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as process:
            # Workers are killed while the batch goes on, the batch itself in the end.
            while kills < most and process.poll() is None:
                time.sleep(random.uniform(0.0, 0.7 * whole_s))
                victims = workers_of(process.pid)
                if victims and random.random() < 0.5:
                    kills += killed(int(random.choice(victims)))
                    tally["workers killed"] += 1
                elif process.poll() is None:
                    process.kill()
                    kills += 1
                    tally["batches killed"] += 1
            process.wait()
        tally["faults"] += faults(out, root / "whole", finished)
        if process.returncode == 0:
            break
        if process.returncode == 1:
            # Three of its workers were killed at one clip: listed as failed, and done when the batch is begun again.
            assert "worker" in (out / "failures.csv").read_text(), (out / "failures.csv").read_text()
    tally["batches done"] += 1
    tally["clips done"] += len(finished)
    if len(finished) != len(scenes) or any(path.name.startswith(".") for path in out.iterdir()):
        tally["faults"] += 1
        print("left behind:", sorted(path.name for path in out.iterdir()))
    return kills


def killed(pid: int) -> int:
    """1 if a process was killed."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return 0
    return 1


def workers_of(pid: int) -> list[int]:
    """The processes that a batch has started to work for it."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        threads = Path(f"/proc/{pid}/task").iterdir()
        children += [child for thread in threads for child in (thread / "children").read_text().split()]
    except OSError:
        return []
    return sorted({int(child) for child in children if b"spawn_main" in command_of(int(child))})


def command_of(pid: int) -> bytes:
    """The command line of a process; empty if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def faults(out: Path, whole: Path, finished: dict[str, int]) -> int:
    """Faults of the folder; keeps the inodes of finished clips."""
    count = 0
    if not out.is_dir():
        return 0
    for folder in [path for path in out.iterdir() if path.is_dir() and not path.name.startswith(".")]:
        inode = folder.stat().st_ino
        if finished.setdefault(folder.name, inode) != inode:
            count += 1
            print(f"{folder.name} was done twice")
        for name in TABLES:
            if (folder / name).read_bytes() != (whole / folder.name / name).read_bytes():
                count += 1
                print(f"{folder.name}/{name} is not what it should be")
    for name in ("results.csv", "failures.csv"):
        if (out / name).exists() and not (out / name).read_bytes().endswith(b"\n"):
            count += 1
            print(f"{name} is half-written")
    return count


if __name__ == "__main__":
    sys.exit(main())
