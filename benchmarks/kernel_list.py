"""Write the list of kernels that commands need, after a kernel, its arguments or a command has changed.

    python benchmarks/kernel_list.py            # some minutes of processor time, in an empty cache
    python benchmarks/kernel_list.py --keep DIR # with the cache in DIR, which saves most of it the next time

The list (`diethrow/kernels.json`) lets a second process compile what the first run needs later, and `diethrow warm-up` compile
all. It names each kernel with the types of its arguments, the kernels that it calls, and the seconds that it takes, in the
order in which the first analysis needs them. `pytest tests/cli/test_warm_up.py --slow` fails if a kernel of these commands is
missing.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

SAMPLES = Path(__file__).parents[1] / "data_samples"
LIST = Path(__file__).parents[1] / "src" / "diethrow" / "kernels.json"
SMALL_ODDS = "odds --throws 200 --chi 0.5"
SMALL_MAP = "basins --pixels 12 12 --samples 64"
SMALL_ORBITS = "lyapunov --orbits 2 --impacts 300"


def commands() -> Iterator[tuple[str, str]]:
    """Names of command and the words of commands that together need every kernel. {out} is a folder for outputs."""
    wood = SAMPLES / "cube_wood" / "scene.toml"
    yield "analyze", f"analyze {wood} --out {{out}}/wood"
    for quality in ("fast", "fine"):
        yield "analyze otherwise", f"analyze {wood} --quality {quality} --out {{out}}/{quality}"
    for name in ("cube_mirror", "tetrahedron_wood", "icosahedron_cork", "cube_wood_photron"):
        yield "analyze otherwise", f"analyze {SAMPLES / name / 'scene.toml'} --out {{out}}/{name}"
    yield "analyze otherwise", f"analyze {wood} --shrink 2 --every 2 --intervals covariance --out {{out}}/less"
    tracks = "{out}/wood/track_frames.csv {out}/fast/track_frames.csv"
    yield "fit", f"fit {{out}}/wood/track_frames.csv --scene {wood} --out {{out}}/fit"
    yield "fit", f"fit {{out}}/wood/track.csv --scene {wood} --intervals bootstrap --out {{out}}/bootstrap"
    yield "fit", f"fit {tracks} --scene {wood} --out {{out}}/joint"
    yield (
        "predict",
        f"predict {{out}}/wood/track_frames.csv --scene {wood} --fit {{out}}/fit/fit.json --out {{out}}/p.csv",
    )
    for file in sorted((SAMPLES / "throws").glob("*.toml")):
        yield "throw", f"throw {file} --out {{out}}/throw_{file.stem}"
    for options in ("", " --mu 0.3"):
        yield "basins", f"{SMALL_MAP} --predictability{options} --out {{out}}/uncertain{options[-1:]}"
    for options in ("", " --mu 0.3", " --amplitude 0.002 --frequency 20", " --amplitude 0.002 --frequency 20 --mu 0.3"):
        label = options.replace(" ", "").replace("-", "")
        yield "odds", f"{SMALL_ODDS}{options} --out {{out}}/odds{label}"
        yield "basins", f"{SMALL_MAP}{options} --out {{out}}/basins{label}"
        yield "basins", f"{SMALL_MAP} --at-impact 2{options} --out {{out}}/impacts{label}"
        yield "lyapunov", f"{SMALL_ORBITS}{options} --out {{out}}/lyapunov{label}"


def main() -> None:
    """Run all commands, and write the list."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", type=Path, metavar="DIR")
    parser.add_argument("--record", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("words", nargs="*", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.record is not None:
        record_command(options.words, options.record)
        return
    with tempfile.TemporaryDirectory() as out:
        cache = options.keep or Path(out) / "cache"
        cache.mkdir(parents=True, exist_ok=True)
        records = [(name, _recorded(words, Path(out), cache)) for name, words in commands()]
    write_list(records)


def _recorded(words: str, out: Path, cache: Path) -> list[Any]:
    """What a command needed."""
    print("diethrow", words, flush=True)
    file = out / "record.json"
    call = [sys.executable, __file__, "--record", str(file), "--", *words.format(out=out).split()]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(call, env=environment, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 2):  # 2: a warning in the output
        print(done.returncode, (done.stderr + done.stdout)[-1000:], flush=True)
    found: list[Any] = json.loads(file.read_text()) if file.exists() else []
    file.unlink(missing_ok=True)
    return found


def record_command(words: list[str], file: Path) -> None:
    """Run one command, and write what it needed: kernel, argument types, caller (or None) and seconds (0 from the cache)."""
    from numba.core.dispatcher import Dispatcher

    needed: list[tuple[Any, Any, Any]] = []
    own = threading.local()  # several threads call kernels
    seconds: dict[Any, float] = {}
    compile_there = Dispatcher.compile

    def compile_and_note(self: Any, signature: Any) -> Any:
        if not isinstance(self._cache, KernelCache):  # numba's own, and closures
            return compile_there(self, signature)
        if not hasattr(own, "callers"):
            own.callers, own.inner_s = [], [0.0]
        callers, inner_s = own.callers, own.inner_s
        version = (self.py_func.__module__, self.py_func.__qualname__, tuple(signature))
        needed.append((version, callers[-1] if callers else None, None))
        callers.append(version)
        begin, misses = time.thread_time(), sum(self._cache_misses.values())
        inner_s.append(0.0)
        try:
            return compile_there(self, signature)
        finally:
            callers.pop()
            taken = time.thread_time() - begin
            without_callees = taken - inner_s.pop()
            inner_s[-1] += taken
            if sum(self._cache_misses.values()) > misses:
                seconds[version] = without_callees
            needed.append((version, None, "done"))

    Dispatcher.compile = compile_and_note
    from diethrow.cli import compiling
    from diethrow.cli import main as run
    from diethrow.model.kernel_cache import KernelCache
    from diethrow.model.kernel_versions import encode

    compiling.cores = lambda: 1  # what a second process compiles would not be seen
    sys.argv = ["diethrow", *words]
    try:
        run()
    finally:
        rows = []
        for version, caller, done in needed:
            encoded = [
                None if each is None else [each[0], each[1], [encode(kind) for kind in each[2]]]
                for each in (version, caller)
            ]
            rows.append([*encoded, done, round(seconds.get(version, 0.0), 3)])
        file.write_text(json.dumps(rows))


def write_list(records: list[tuple[str, list[Any]]]) -> None:
    """Write the list of all that was recorded, callees before callers."""
    calls: dict[str, set[str]] = {}
    seconds: dict[str, float] = {}
    order: list[str] = []
    runs: dict[str, list[str]] = {}
    for name, rows in records:
        for version, caller, done, taken in rows:
            key = json.dumps(version)
            seconds[key] = max(seconds.get(key, 0.0), taken)
            calls.setdefault(key, set())
            if done:
                if key not in order:
                    order.append(key)
            elif caller is not None:
                calls.setdefault(json.dumps(caller), set()).add(key)
            else:
                runs.setdefault(name, [])
                if key not in runs[name]:
                    runs[name].append(key)
    number = {key: k for k, key in enumerate(order)}
    types: dict[str, int] = {}

    def of_type(kind: Any) -> int:
        """The number of a type in the list of types; the types that it is made of come before."""
        if isinstance(kind, list):
            kind = [[of_type(one) for one in each] if isinstance(each, list) else each for each in kind]
        return types.setdefault(json.dumps(kind), len(types))

    lines = []
    for key in order:
        module, kernel, arguments = json.loads(key)
        uses = sorted(number[each] for each in calls[key] if each != key)
        lines.append(json.dumps([module, kernel, [of_type(each) for each in arguments], uses, seconds[key]]))
    needs = {name: [number[key] for key in keys] for name, keys in runs.items()}
    LIST.write_text(
        '{"types": [\n'
        + ",\n".join(types)
        + '\n], "versions": [\n'
        + ",\n".join(lines)
        + '\n], "runs": '
        + json.dumps(needs)
        + "}\n"
    )
    print(f"{LIST}: {len(order)} versions, {sum(seconds.values()):.0f} s")


if __name__ == "__main__":
    main()
