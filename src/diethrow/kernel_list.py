"""The list of kernels that commands need, and their compilation by several processes.

`kernels.json` names every kernel with the types of its arguments, the kernels that it calls and the processor time that it takes.
`benchmarks/kernel_list.py` writes it. A kernel can be compiled once all that it calls is in the cache; so a `Schedule` hands out
what is ready, to processes of its own and beside one that compiles what it comes upon. An entry whose kernel or types no longer
exist is left out: it costs time in the first run, and nothing else.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from threading import Condition
from typing import Any

from .executors import Processes

FILE = Path(__file__).parent / "kernels.json"
FIRST_RUN = "analyze"
"""What the list calls the kernels of the first analysis."""
BATCH_S = 0.5
"""Processor time [s] of what a process is given at once: long against the way to it and back."""


@cache
def _listed() -> Any:
    return json.loads(FILE.read_text(encoding="utf-8"))


@cache
def _types() -> list[Any]:
    """numba's types of the list, None for those that no longer exist."""
    from .model.kernel_versions import decode

    found: list[Any] = []
    for text in _listed()["types"]:
        try:
            found.append(decode(text, found))
        except (ImportError, AttributeError, ValueError):
            found.append(None)
    return found


@cache
def version(number: int) -> Any:
    """An entry of the list as `model.kernel_versions.Version`, or None if it no longer exists."""
    from .model.kernel_versions import Version

    module, kernel, arguments, _, _ = _listed()["versions"][number]
    types = tuple(_types()[each] for each in arguments)
    entry = Version(module, kernel, types)
    try:
        return entry if None not in types and hasattr(entry.dispatcher, "_cache") else None
    except (ImportError, AttributeError):
        return None


def needed(run: str | None = None) -> list[int]:
    """Numbers of all entries that a run needs, callees before callers; of all runs without a name."""
    runs = _listed()["runs"]
    ahead = [number for name, numbers in runs.items() if run in (None, name) for number in numbers]
    found: set[int] = set()
    while ahead:
        number = ahead.pop()
        if number not in found:
            found.add(number)
            ahead += _calls(number)
    return sorted(found)


def missing(run: str | None = None) -> list[int]:
    """Numbers of the entries that a run, or any, needs and the cache does not have."""
    return [number for number in needed(run) if version(number) is not None and not version(number).is_kept()]


def cache_folder() -> Path:
    """The folder below which the cache lies: numba's, or that of the sources, each with its own cache."""
    entries = [entry for number in needed() if (entry := version(number)) is not None]
    return Path(os.path.commonpath([entry.dispatcher._cache.cache_path for entry in entries] or [os.curdir]))


def compile_listed(numbers: Iterable[int]) -> int:
    """Compile entries of the list one after the other; return how many failed."""
    from .model.kernel_versions import rare_collections

    failed = 0
    for number in numbers:
        entry = version(number)
        try:
            if entry is not None:
                with rare_collections():
                    entry.compile()
        except (
            Exception
        ):  # types that a kernel no longer takes; whoever calls the kernel compiles it, and sees the error
            failed += 1
    return failed


def _calls(number: int) -> list[int]:
    return list(_listed()["versions"][number][3])


def _seconds(number: int) -> float:
    return float(_listed()["versions"][number][4])


class Schedule:
    """What is still to be compiled, what is being compiled, and by whom next."""

    def __init__(self, numbers: Iterable[int], *, last_first: bool, report: Callable[[int, int], None]) -> None:
        """`last_first`: begin with what the run needs last, which suits a helper. Otherwise the longest chain of callers first.
        `report` is called with the number compiled and their total.
        """
        self._waiting = set(numbers)
        self._under_way: set[int] = set()
        self._is_given_up = False
        self._total = len(self._waiting)
        self._report = report
        self._changed = Condition()
        self._numbers = {version(number): number for number in self._waiting}
        report(0, self._total)
        self._rank = (
            {number: float(number) for number in self._waiting} if last_first else _time_to_the_end(self._waiting)
        )

    @property
    def done(self) -> int:
        """Number of entries compiled."""
        return self._total - len(self._waiting) - len(self._under_way)

    @property
    def left(self) -> list[int]:
        """Entries that nobody compiles."""
        return sorted(self._waiting)

    @property
    def total(self) -> int:
        """Number of entries to compile."""
        return self._total

    def begin(self, entry: Any) -> None:
        """Another process began to compile a version."""
        with self._changed:
            number = self._numbers.get(entry)
            if number in self._waiting:
                self._waiting.discard(number)
                self._under_way.add(number)

    def end(self, entry: Any) -> None:
        """It has compiled it."""
        self._end([self._numbers[entry]] if entry in self._numbers else [])

    def take(self) -> list[int]:
        """Entries for a process to compile one after the other; waits until some are ready. None are left if there are none."""
        with self._changed:
            while not (ready := self._ready(())) and self._waiting and not self._is_given_up:
                self._changed.wait()
            if self._is_given_up:
                return []
            batch: list[int] = []
            while ready and (not batch or sum(map(_seconds, batch)) < BATCH_S):
                number = max(ready, key=self._rank.__getitem__)
                batch.append(number)
                self._waiting.discard(number)
                ready = self._ready(batch)
            self._under_way.update(batch)
            return batch

    def give_up(self) -> None:
        """Nothing more is compiled; whoever waits for work gets none."""
        with self._changed:
            self._is_given_up = True
            self._changed.notify_all()

    def _ready(self, before: Iterable[int]) -> list[int]:
        """What calls nothing that is still to be compiled, but for what the same process compiles before."""
        open_ones = (self._waiting | self._under_way) - set(before)
        return [number for number in self._waiting if open_ones.isdisjoint(_calls(number))]

    def _end(self, numbers: Iterable[int]) -> None:
        with self._changed:
            self._under_way.difference_update(numbers)
            self._waiting.difference_update(numbers)
            self._changed.notify_all()
        self._report(self.done, self.total)

    def serve(self, processes: Processes) -> int:
        """Let one of the processes compile what is ready, until nothing is left; return how many entries failed.

        Its death ends the service.
        """
        failed = 0
        while batch := self.take():
            try:
                failed += processes.submit(compile_listed, batch).result()
            except RuntimeError:  # of a lost or stopped process
                return failed + len(batch)
            finally:
                self._end(batch)
        return failed


def _time_to_the_end(numbers: Iterable[int]) -> dict[int, float]:
    """Seconds that each entry and the longest chain of its callers take: what must begin first."""
    rank: dict[int, float] = {}
    for number in sorted(numbers, reverse=True):  # callers come after what they call
        rank[number] = rank.get(number, 0.0) + _seconds(number)
        for callee in _calls(number):
            rank[callee] = max(rank.get(callee, 0.0), rank[number])
    return rank
