"""Times, memory and spreads, as several benchmarks print them."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

T = TypeVar("T")


def timed(work: Callable[[], T], clock: Callable[[], float] = time.process_time) -> tuple[T, float]:
    """The result of some work, and its duration [s] by that clock: by default, processor time."""
    began = clock()
    result = work()
    return result, clock() - began


def spread(values: Sequence[float], digits: int = 0) -> str:
    """Median and range."""
    return f"{np.median(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def peak_MB() -> float:
    """Peak memory of this process."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def write_table(page: Path, name: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Replace the table that a benchmark of this name has written into a page of the documents, between its marks."""
    begin, end = f"<!-- written by benchmarks/{name} -->", "<!-- end -->"
    before, rest = page.read_text(encoding="utf-8").split(begin)
    _, after = rest.split(end, 1)
    table = "\n".join("| " + " | ".join(cells) + " |" for cells in (heads, ["---"] * len(heads), *rows))
    page.write_text(f"{before}{begin}\n\n{table}\n\n{end}{after}", encoding="utf-8")
