"""Compare the numbers of two folders of results: tables by columns, JSON by keys, arrays by name.

The difference of two numbers is given as a share of the largest number in their column. `diethrow rerun` compares a
repeated run with the first one; `benchmarks/same_numbers.py` compares versions of the program.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...files.csv_and_json import read_json

COMPARED = (".csv", ".json", ".npy", ".npz", ".toml")
"""Suffixes of files with numbers; recordings and pages show the numbers of these."""
UNCOMPARED = ("provenance.json",)
"""Contains times and the command line."""


@dataclass(frozen=True)
class Difference:
    """The two values of one column of one file that differ most."""

    file: str
    column: str
    """Name of the column of a table, path of keys in JSON, or name of the array."""
    was: str
    now: str
    share: float
    """|now - was| over the largest magnitude in the column; infinite if they are not both numbers."""

    @property
    def sentence(self) -> str:
        """`fit.json: parameters.chi.value was 0.5 and is 0.6 now, 0.17 of the column's largest`."""
        by = "" if math.isinf(self.share) else f", {self.share:.2g} of the column's largest"
        return f"{self.file}: {self.column} was {self.was or 'empty'} and is {self.now or 'empty'} now{by}"


def compare(old: Path, new: Path) -> tuple[tuple[str, ...], tuple[Difference, ...]]:
    """The files of two folders that are the same bit by bit, and the largest difference of each column of the others."""
    same, found = [], []
    for name in compared_files(old, new):
        paths = old / name, new / name
        if not all(path.is_file() for path in paths):
            was, now = ("there" if path.is_file() else "missing" for path in paths)
            found.append(Difference(name, "the file", was, now, math.inf))
        elif paths[0].read_bytes() == paths[1].read_bytes():
            same.append(name)
        else:
            found += differences(name, columns_of(paths[0]), columns_of(paths[1]))
    return tuple(same), tuple(found)


def compared_files(old: Path, new: Path) -> list[str]:
    """Names, relative to their folder, of all files with numbers in either of two folders."""
    files = [(file, folder) for folder in (old, new) for file in folder.rglob("*") if file.suffix in COMPARED]
    return sorted({str(file.relative_to(folder)) for file, folder in files if file.name not in UNCOMPARED})


def columns_of(path: Path) -> dict[str, list[Any]]:
    """The values of a file by name: columns of a table, arrays, values of JSON by their path of keys, or lines of text."""
    if path.suffix == ".csv":
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        return {
            name: [row[k] if k < len(row) else "" for row in rows[1:]] for k, name in enumerate(rows[0] if rows else [])
        }
    if path.suffix == ".json":
        columns: dict[str, list[Any]] = {}
        for name, value in _leaves(read_json(path)):
            columns.setdefault(name, []).append(value)
        return columns
    if path.suffix == ".npy":
        return {"array": np.load(path, allow_pickle=False).ravel().tolist()}
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            return {name: arrays[name].ravel().tolist() for name in arrays.files}
    return {"text": path.read_text(encoding="utf-8").splitlines()}


def differences(file: str, old: dict[str, list[Any]], new: dict[str, list[Any]]) -> Iterator[Difference]:
    """The largest difference of each column that differs."""
    for name in dict.fromkeys([*old, *new]):
        was, now = old.get(name), new.get(name)
        if was is None or now is None or len(was) != len(now):
            sizes = ["absent" if column is None else f"{len(column)} values" for column in (was, now)]
            yield Difference(file, name, sizes[0], sizes[1], math.inf)
            continue
        numbers = [number for value in (*was, *now) if (number := finite_number(value)) is not None]
        largest = max(map(abs, numbers), default=0.0)
        pairs = [(_share_of_difference(a, b, largest), a, b) for a, b in zip(was, now, strict=True)]
        share, a, b = max(pairs, key=lambda pair: pair[0], default=(0.0, "", ""))
        if share > 0.0:
            yield Difference(file, name, _shown(a), _shown(b), share)


def finite_number(value: Any) -> float | None:
    """The value as a number; None for anything else, for truth values, and for numbers that are not finite."""
    if isinstance(value, bool) or value is None:
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of nested tables with its path of keys; the items of a list share a path."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _leaves(part, f"{name}.{key}" if name else key)
    elif isinstance(value, list):
        for part in value:
            yield from _leaves(part, name)
    else:
        yield name, value


def _share_of_difference(a: Any, b: Any, largest: float) -> float:
    """The difference of two values as a share of the largest number in their column."""
    if a == b:
        return 0.0
    first, second = finite_number(a), finite_number(b)
    if first is None or second is None:
        return 0.0 if str(a) == str(b) else math.inf  # two NaN are equal here
    return abs(second - first) / largest


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
