"""Waiting time of a user: help, import, and the compilation of the first run.

    python benchmarks/startup.py                # help and import, the best of seven
    python benchmarks/startup.py --compile      # and which kernels the first analysis compiles, in an empty cache
    python benchmarks/startup.py --compile --alone    # the same without a second process

Times of compilation are processor times, which other load hardly changes.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from contextlib import nullcontext
from pathlib import Path
from typing import Any

SCENE = Path(__file__).parents[1] / "data_samples" / "cube_wood" / "scene.toml"
KERNELS_SHOWN = 12


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--compile", action="store_true")
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--in-empty-cache", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.in_empty_cache:
        _first_run(options.alone)
        return
    for name, program in (("diethrow --help", HELP), ("import diethrow", "import diethrow"), ("python alone", "pass")):
        print(f"{name:16} {best_s(program):.3f} s", flush=True)
    if options.compile:
        with tempfile.TemporaryDirectory() as cache:
            environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
            words = [sys.executable, __file__, "--in-empty-cache", *(["--alone"] if options.alone else [])]
            subprocess.run(words, env=environment, check=True)


HELP = "import sys; sys.argv = ['diethrow', '--help']; from diethrow.cli import main; main()"


def best_s(program: str) -> float:
    """Seconds of a whole process, the best of seven."""
    times = []
    for _ in range(7):
        begin = time.perf_counter()
        subprocess.run([sys.executable, "-c", program], check=True, stdout=subprocess.DEVNULL)
        times.append(time.perf_counter() - begin)
    return min(times)


def _first_run(alone: bool) -> None:
    """Analyse the sample with an empty cache, and report what was compiled and the time it took."""
    from numba.core import event

    clock = _CompileClock()
    event.register("numba:compile", clock.listener)
    from diethrow.cli.compiling import model_ahead
    from diethrow.commands.clip.analyze import analyze
    from diethrow.files.scene import read_scene

    begin, begin_cpu = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as out, nullcontext() if alone else model_ahead():
        analyze(read_scene(SCENE), Path(out) / "out")
    wall, cpu = time.perf_counter() - begin, time.process_time() - begin_cpu
    helper = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"first analysis   {wall:.0f} s, {cpu:.0f} s of processor time and {helper.ru_utime + helper.ru_stime:.0f} s of a"
    )
    print(f"                 second process; compiled here, {clock.total_s:.0f} s:")
    for name, (count, seconds) in sorted(clock.outermost.items(), key=lambda each: -each[1][1])[:KERNELS_SHOWN]:
        print(f"  {seconds:6.1f} s  {name}" + (f", for {count} signatures" if count > 1 else ""))


class _CompileClock:
    """Processor time by the kernel that was called from Python, with all that it calls."""

    def __init__(self) -> None:
        from numba.core import event

        own = threading.local()
        outermost: dict[str, list[Any]] = defaultdict(lambda: [0, 0.0])
        self.outermost = outermost

        class Listener(event.Listener):  # type: ignore[misc]
            def on_start(self, happening: Any) -> None:
                own.begun = [*getattr(own, "begun", []), time.thread_time()]

            def on_end(self, happening: Any) -> None:
                begun = own.begun.pop()
                if not own.begun:
                    function = happening.data["dispatcher"].py_func
                    row = outermost[f"{function.__module__}.{function.__name__}"]
                    row[0] += 1
                    row[1] += time.thread_time() - begun

        self.listener = Listener()

    @property
    def total_s(self) -> float:
        return float(sum(seconds for _, seconds in self.outermost.values()))


if __name__ == "__main__":
    main()
