"""The command warm-up: all kernels compiled on purpose, so that no later command waits for it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numba

from ...executors import Processes, cores
from ...kernel_list import Schedule, cache_folder, missing, needed
from ...model.errors import InputError


@dataclass(frozen=True)
class WarmUp:
    """What `warm_up` did."""

    kernels: int
    """Versions of kernels that the commands need."""
    compiled: int
    """Of these, how many it compiled; the others were in the cache."""
    failed: int
    """Of these, how many were not compiled, and will be when they are called."""
    seconds: float
    processes: int
    folder: Path
    """The folder that holds the cache, or the cache of every source folder."""


def warm_up(processes: int | None = None, report: Callable[[str, int, int], None] | None = None) -> WarmUp:
    """Compile all kernels that the commands need and the cache does not have, with one process per core by default.

    `report` is called with the stage, the number of kernels compiled and their total. Raises InputError below one process, and
    if NUMBA_DISABLE_JIT forbids to compile.
    """
    if numba.config.DISABLE_JIT:
        raise InputError("NUMBA_DISABLE_JIT is set: nothing is compiled; unset it for warm-up")
    begin = time.monotonic()
    workers = cores() if processes is None else processes
    total, lacking = len(needed()), missing()
    failed = 0
    if lacking:
        progress = report or (lambda *_: None)
        schedule = Schedule(lacking, last_first=False, report=lambda done, all_: progress("Kernels", done, all_))
        with Processes(workers) as pool, ThreadPoolExecutor(workers) as threads:
            served = [threads.submit(schedule.serve, pool) for _ in range(workers)]
            try:
                failed = sum(each.result() for each in served)
            except BaseException:
                schedule.give_up()
                pool.stop()
                raise
        failed += len(schedule.left)
    return WarmUp(total, len(lacking) - failed, failed, time.monotonic() - begin, workers, cache_folder())


def summary(done: WarmUp) -> str:
    """One sentence for the terminal."""
    where = f"the cache lies in {done.folder}{os.sep}"
    if not done.compiled and not done.failed:
        return f"Nothing to do: all {done.kernels} kernels are compiled; {where}"
    on = f"{done.processes} process{'es' if done.processes > 1 else ''}"
    text = f"{done.compiled} kernels compiled in {done.seconds:.0f} s by {on}; {where}"
    return f"{text}. {done.failed} were not compiled; the command that needs them does so" if done.failed else text
