"""Waiting time of a user: help, import, and the compilation of the first run.

    python benchmarks/startup.py                # help and import, the best of seven
    python benchmarks/startup.py --compile      # and each kernel that the first analysis compiles, in an empty cache
    python benchmarks/startup.py --compile --alone    # the same without a second process

Times of compilation are processor times, which other load hardly changes. A kernel's own time is without that of the kernels of
this package that it calls; numba's functions count with the kernel that calls them.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import nullcontext
from pathlib import Path
from typing import Any

SCENE = Path(__file__).parents[1] / "data_samples" / "cube_wood" / "scene.toml"
NOTES = "DIETHROW_COMPILATION_NOTES"
"""The environment variable that names the folder in which each process notes what it compiled."""


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
        with tempfile.TemporaryDirectory() as folder:
            environment = {**os.environ, "NUMBA_CACHE_DIR": f"{folder}/cache", NOTES: folder}
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
    """Analyse the sample with an empty cache, and report what was compiled, where, and the time it took."""
    from diethrow.cli.compiling import shared_compilation
    from diethrow.commands.clip.analyze import analyze
    from diethrow.files.scene import read_scene

    begin, begin_cpu = time.perf_counter(), time.process_time()
    helped = nullcontext() if alone else shared_compilation("analyze", lambda done, total: None)
    with tempfile.TemporaryDirectory() as out, helped:
        analyze(read_scene(SCENE), Path(out) / "out")
    wall, cpu = time.perf_counter() - begin, time.process_time() - begin_cpu
    others = resource.getrusage(resource.RUSAGE_CHILDREN)
    others_s = others.ru_utime + others.ru_stime
    notes = [
        json.loads(line) for file in Path(os.environ[NOTES]).glob("*.jsonl") for line in file.read_text().splitlines()
    ]
    here = [note for note in notes if note["process"] == os.getpid()]
    there = [note for note in notes if note["process"] != os.getpid()]
    print(f"first analysis   {wall:.0f} s: {cpu:.0f} s of processor time, {others_s:.0f} s of other processes")
    for where, some in (("this process", here), ("other processes", there)):
        print(f"{where:16} {len(some)} kernels, {_sum(some, 'own'):.0f} s")
    both = {(note["kernel"], note["arguments"]) for note in here} & {
        (note["kernel"], note["arguments"]) for note in there
    }
    waste = [note for note in there if (note["kernel"], note["arguments"]) in both]
    print(f"compiled twice   {len(waste)} kernels, {_sum(waste, 'own'):.1f} s")
    _print_kernels(notes)


def _print_kernels(notes: list[dict[str, Any]]) -> None:
    """A line for each kernel, the costliest first."""
    versions = Counter(note["kernel"] for note in notes)
    print("     own  with callees  kernel [s of processor time]")
    own = {name: _sum([note for note in notes if note["kernel"] == name], "own") for name in versions}
    for name in sorted(own, key=own.__getitem__, reverse=True):
        inclusive = _sum([note for note in notes if note["kernel"] == name], "with_callees")
        print(
            f"{own[name]:8.2f}  {inclusive:12.2f}  {name}" + (f", {versions[name]} times" if versions[name] > 1 else "")
        )
    print(f"{sum(own.values()):8.2f}  {'':12}  in total, {len(own)} kernels")


def _sum(notes: list[dict[str, Any]], what: str) -> float:
    return float(sum(note[what] for note in notes))


def note_compilations(folder: str) -> None:
    """Note in a file of this process what it compiles from now on."""
    from numba.core import event
    from numba.core.caching import NullCache

    own = threading.local()
    file = Path(folder) / f"{os.getpid()}.jsonl"

    class Listener(event.Listener):  # type: ignore[misc]
        def on_start(self, happening: Any) -> None:
            if not isinstance(happening.data["dispatcher"]._cache, NullCache):
                own.open = [*getattr(own, "open", []), [time.thread_time(), 0.0]]

        def on_end(self, happening: Any) -> None:
            dispatcher = happening.data["dispatcher"]
            if not isinstance(dispatcher._cache, NullCache):
                begin, of_callees = own.open.pop()
                taken = time.thread_time() - begin
                if own.open:
                    own.open[-1][1] += taken
                function = dispatcher.py_func
                note = {
                    "process": os.getpid(),
                    "kernel": f"{function.__module__}.{function.__qualname__}",
                    "arguments": str(happening.data["args"]),
                    "own": taken - of_callees,
                    "with_callees": taken,
                }
                with file.open("a", encoding="utf-8") as lines:
                    lines.write(json.dumps(note) + "\n")

    event.register("numba:compile", Listener())


if NOTES in os.environ and "--in-empty-cache" in sys.argv:  # also in the other processes, which import this file
    note_compilations(os.environ[NOTES])

if __name__ == "__main__":
    main()
