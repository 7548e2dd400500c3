"""Speed of two workers over one, and over single commands, for whole analyses of clips.

    python benchmarks/batch.py --clips 10 --repeats 2 --singles

Analyses copies of the short sample with one worker and with two in turn, with `--singles` also by one `diethrow analyze` a clip,
one after the other, and prints the ratios of the times. The machine should be idle; the load before the run is printed beside the
figures.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from diethrow.commands.clip.batch import run_batch

SAMPLE = Path(__file__).parents[1] / "data_samples" / "cube_wood_photron"


def main() -> None:
    """Copy, analyse, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=12)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--workers", type=int, nargs=2, default=(1, 2))
    parser.add_argument("--only-track", action="store_true")
    parser.add_argument("--singles", action="store_true")
    options = parser.parse_args()
    print(f"load before: {os.getloadavg()[0]:.2f} on {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        scenes = [copied(root / f"clip_{k:02d}") for k in range(options.clips)]
        few, many = options.workers
        for repeat in range(options.repeats):
            seconds = {}
            for workers in (few, many):
                seconds[workers] = timed(scenes, root / f"out_{repeat}_{workers}", workers, options.only_track)
            print(
                f"{options.clips} clips: {few} worker {seconds[few]:.1f} s, {many} workers {seconds[many]:.1f} s, "
                f"ratio {seconds[few] / seconds[many]:.2f}",
                flush=True,
            )
            if options.singles:
                alone = singles(scenes, root / f"alone_{repeat}")
                share = seconds[many] / alone
                print(
                    f"    single commands {alone:.1f} s, of which {many} workers take {100 * share:.0f} %", flush=True
                )


def singles(scenes: list[Path], out: Path) -> float:
    """Seconds of one command a clip, one after the other."""
    out.mkdir()
    program = "import sys; from diethrow.cli import main; sys.argv[0] = 'diethrow'; main()"
    begin = time.perf_counter()
    for k, scene in enumerate(scenes):
        words = [sys.executable, "-c", program, "analyze", str(scene), "--out", str(out / str(k))]
        subprocess.run(words, check=True, capture_output=True)
    return time.perf_counter() - begin


def copied(folder: Path) -> Path:
    """The scene of a copy of the sample."""
    shutil.copytree(SAMPLE, folder)
    return folder / "scene.toml"


def timed(scenes: list[Path], out: Path, workers: int, only_track: bool) -> float:
    """Seconds of a whole batch, the start of the workers among them."""
    begin = time.perf_counter()
    batch = run_batch(scenes, out, workers=workers, stage="track" if only_track else "analyze")
    took = time.perf_counter() - begin
    assert len(batch.results) == len(scenes), batch.failures
    return took


if __name__ == "__main__":
    main()
