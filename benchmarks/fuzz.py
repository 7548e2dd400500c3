"""Fuzz the readers of all files that users receive from others: headers, scenes, throws, tracks, fits.

    PYTHONPATH=tests/helpers python benchmarks/fuzz.py --runs 100000            # own mutations, divided among the kinds of file
    PYTHONPATH=tests/helpers python benchmarks/fuzz.py --minutes 30 --atheris cine    # guided by coverage; pip install atheris

A reader may read a file or refuse it with a message. Any other exception, more than 10 s for a file, and more than 1 GB of memory
are defects. The bytes of such a file are kept in the folder of --finds, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np
from fuzz_targets import Target, mutated, targets
from measuring import peak_MB

MAX_S = 10
"""Longest time for one file."""
MEMORY_BYTES = 2**30
"""Memory for one file, in addition to that of the program and its libraries before the first file."""


class TooSlowError(BaseException):
    """A reader took too long; a BaseException, which no reader catches."""


def main() -> int:
    """Fuzz, and print the defects found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100_000, help="files of all kinds together")
    parser.add_argument("--minutes", type=float, help="instead of --runs")
    parser.add_argument("--kinds", nargs="+", help="left out: all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--finds", type=Path, default=Path("finds"))
    parser.add_argument("--atheris", metavar="KIND", help="let atheris guide the mutations of one kind by coverage")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as temporary:
        folder = Path(temporary)
        every = {target.name: target for target in targets(folder)}
        for target in every.values():
            for content in target.seeds:
                target.read(folder, content)  # loads modules before the memory is limited
        _limit_memory()
        if options.atheris:
            return _guided_by_coverage(every[options.atheris], folder, options.minutes or 1.0, options.finds)
        chosen = [every[name] for name in options.kinds or every]
        return _mutations(chosen, folder, options.runs, options.minutes, options.seed, options.finds)


def _mutations(chosen: list[Target], folder: Path, runs: int, minutes: float | None, seed: int, finds: Path) -> int:
    found = 0
    until = time.monotonic() + 60.0 * minutes if minutes else None
    for number, target in enumerate(chosen):
        random = np.random.default_rng([seed, number])
        begin, done, slowest = time.monotonic(), 0, 0.0
        share_until = None if until is None else begin + (until - begin) / (len(chosen) - number)
        while done < runs // len(chosen) if share_until is None else time.monotonic() < share_until:
            content = mutated(target, random)
            started = time.monotonic()
            defect = _defect(target, folder, content)
            slowest = max(slowest, time.monotonic() - started)
            if defect:
                found += 1
                _keep(finds, target.name, content, defect)
            done += 1
        spent = time.monotonic() - begin
        print(f"{target.name:12} {done:8} files in {spent:6.0f} s, slowest {slowest:.3f} s", flush=True)
    most_mb = peak_MB()
    print(f"{found} defects; most memory {most_mb:.0f} MB, the program and its libraries among it")
    return 1 if found else 0


def _defect(target: Target, folder: Path, content: bytes) -> str:
    """The defect in reading a file; empty without one."""
    try:
        with _at_most(MAX_S):
            target.read(folder, content)
    except TooSlowError:
        return f"longer than {MAX_S} s"
    except MemoryError:
        return f"more than {MEMORY_BYTES} bytes"
    except Exception as error:  # any other exception is a defect
        return f"{type(error).__name__}: {error}"
    return ""


def _guided_by_coverage(target: Target, folder: Path, minutes: float, finds: Path) -> int:
    """Fuzz with atheris, which keeps mutations that reach new lines of the readers."""
    import atheris

    for module in [name for name in sys.modules if name.startswith("diethrow.") and "kernels" not in name]:
        for each in vars(sys.modules[module]).values():
            if callable(each) and getattr(each, "__module__", None) == module and hasattr(each, "__code__"):
                atheris.instrument_func(each)
    corpus = folder / "corpus"
    corpus.mkdir()
    for number, content in enumerate(target.seeds):
        (corpus / str(number)).write_bytes(content)

    def one(content: bytes) -> None:
        if defect := _defect(target, folder, content):
            _keep(finds, target.name, content, defect)
            raise AssertionError(defect)

    # 0: the limit of memory is set already.
    words = [
        sys.argv[0],
        str(corpus),
        f"-max_total_time={int(60 * minutes)}",
        "-rss_limit_mb=0",
        f"-artifact_prefix={folder}/",
    ]
    atheris.Setup(words, one)
    atheris.Fuzz()
    return 0


def _keep(finds: Path, name: str, content: bytes, defect: str) -> None:
    finds.mkdir(parents=True, exist_ok=True)
    number = len(list(finds.iterdir()))
    (finds / f"{name}_{number}").write_bytes(content)
    print(f"{name}: {defect[:300]} ({finds / f'{name}_{number}'})", flush=True)


def _limit_memory() -> None:
    """Limit the growth of the process to MEMORY_BYTES."""
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + MEMORY_BYTES, resource.RLIM_INFINITY))


@contextmanager
def _at_most(seconds: int) -> Iterator[None]:
    def late(signum: int, frame: FrameType | None) -> None:
        raise TooSlowError

    before: Callable[..., object] | int | None = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


if __name__ == "__main__":
    sys.exit(main())
