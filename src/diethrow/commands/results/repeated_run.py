"""`diethrow rerun`: do again what a folder of results says of itself, and compare every number.

`provenance.json` names the command, the folder it was given in, and the digest of every input. The run is repeated beside
the old results and thrown away; what is kept is the comparison. On the same machine and version every number agrees bit for
bit; elsewhere the last digits may differ, and `within` says how far they may.
"""

from __future__ import annotations

import csv
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ... import __version__
from ...files.provenance import sha256
from ...files.tables import read_json

UNCOMPARED = {"provenance.json": "holds times", "replay.rrd": "a recording", "report.html": "a page"}
"""Files without numbers of their own; what they show is in the tables."""
COMPARED = (".csv", ".json", ".npy", ".npz", ".toml")
WITHIN = 1e-6
"""Largest difference, as a share of the largest number of its column, that is taken for rounding on another machine."""


@dataclass(frozen=True)
class Difference:
    """The numbers of one column of one file that differ most."""

    file: str
    column: str
    """Of a table; the path of keys in JSON; the array in a file of several."""
    was: str
    now: str
    share: float
    """|now - was| over the largest size in the column; infinite where they are not both numbers."""

    @property
    def sentence(self) -> str:
        """`fit.json: parameters.chi.value was 0.5, is 0.6 now (17 % of the column's largest)`."""
        by = "" if math.isinf(self.share) else f", {self.share:.2g} of the column's largest"
        return f"{self.file}: {self.column} was {self.was or 'empty'} and is {self.now or 'empty'} now{by}"


@dataclass(frozen=True)
class Comparison:
    """What a repeated run says of the first."""

    same: tuple[str, ...]
    """Files that are the same bit for bit."""
    differences: tuple[Difference, ...]
    """The largest of each column that is not."""
    within: float
    notices: tuple[str, ...]
    """What is not as it was: version, packages, one sentence each."""

    @property
    def agree(self) -> bool:
        """Whether every number is what it was, or within what was allowed."""
        return all(difference.share <= self.within for difference in self.differences)


def rerun(folder: Path, *, within: float = WITHIN) -> Comparison:
    """Do again what `folder` holds, and compare.

    Raises FileNotFoundError where there is no provenance, ValueError where it does not say what was done, an input is not
    what it was, or the run fails now.
    """
    folder = Path(folder).resolve()
    origin = read_json(folder / "provenance.json")
    command, place = _command_of(origin, folder)
    _demand_same_inputs(origin, place, folder)
    with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", suffix=".again", dir=folder.parent) as aside:
        again = Path(aside) / folder.name
        _run([*command, "--out", str(again)], place, folder)
        same, differences = compare(folder, again)
    return Comparison(same, differences, within, tuple(_notices(origin)))


def compare(old: Path, new: Path) -> tuple[tuple[str, ...], tuple[Difference, ...]]:
    """The files of two folders that are the same, and the largest difference of each column of those that are not."""
    same, differences = [], []
    for name in sorted({file.name for folder in (old, new) for file in folder.iterdir() if file.suffix in COMPARED}):
        if name in UNCOMPARED:
            continue
        paths = old / name, new / name
        if not all(path.is_file() for path in paths):
            there = ["there" if path.is_file() else "missing" for path in paths]
            differences.append(Difference(name, "the file", there[0], there[1], math.inf))
        elif paths[0].read_bytes() == paths[1].read_bytes():
            same.append(name)
        else:
            differences += _differences(name, *(_columns_of(path) for path in paths))
    return tuple(same), tuple(differences)


def summary(comparison: Comparison, most: int = 10) -> list[str]:
    """What came out, in a few lines."""
    lines = list(comparison.notices)
    differences = sorted(comparison.differences, key=lambda each: -each.share)
    lines += [each.sentence for each in differences[:most]]
    if len(differences) > most:
        lines.append(f"and {len(differences) - most} more columns")
    files = len(comparison.same) + len({each.file for each in differences})
    if not differences:
        lines.append(f"The numbers agree bit for bit, in all {files} files.")
    elif comparison.agree:
        lines.append(
            f"The numbers agree within {comparison.within:g}; {len(comparison.same)} of {files} files bit for bit."
        )
    else:
        lines.append(f"The numbers do not agree within {comparison.within:g}.")
    return lines


def _command_of(origin: Any, folder: Path) -> tuple[list[str], Path]:
    """The arguments of the command without its output, and where it was given. Raises ValueError where that is not said."""
    try:
        words = [str(word) for word in origin["command"]]
        place = Path(origin["folder"])
    except (KeyError, TypeError) as error:
        raise ValueError(f"{folder}: provenance.json does not say what was done; wanted results of diethrow") from error
    if len(words) < 2 or "--out" not in words[:-1]:
        raise ValueError(f"{folder}: provenance.json names no command that can be repeated, but {words}")
    at = words.index("--out")
    kept = words[1:at] + words[at + 2 :]
    return [word for word in kept if word not in ("--force", "--resume")], place


def _demand_same_inputs(origin: Any, place: Path, folder: Path) -> None:
    """Raises ValueError for an input that is gone or not what it was."""
    for each in origin["inputs"]:
        path = place / each["path"]
        if not path.is_file():
            raise ValueError(f"{folder} cannot be made again: {path} is not there any longer; put it back")
        if path.stat().st_size != each["bytes"] or sha256(path) != each["sha256"]:
            raise ValueError(f"{folder} cannot be made again: {path} has changed since; put the old one back")


def _run(arguments: list[str], place: Path, folder: Path) -> None:
    """The command, in a process of its own: it begins as it began then, whatever this process has loaded."""
    if not place.is_dir():
        raise ValueError(f"{folder} cannot be made again: its command was given in {place}, which is not there")
    program = "from diethrow.cli import main; main()"
    result = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        cwd=place,
        env={**os.environ, "COLUMNS": str(shutil.get_terminal_size().columns)},
        capture_output=True,
        text=True,
        check=False,
    )
    # Status 1 of a check says that something is bad, not that it failed; the folder is what counts.
    if not Path(arguments[-1]).exists():
        said = result.stderr.strip().splitlines() or ["it said nothing"]
        raise ValueError(f"{folder} cannot be made again: {said[-1].removeprefix('diethrow: ')}")


def _notices(origin: Any) -> Iterator[str]:
    from ...files.provenance import package_versions

    if origin["diethrow"] != __version__:
        yield f"The results were made by version {origin['diethrow']}, and this is {__version__}."
    for name, version in package_versions().items():
        then = origin["packages"].get(name, "not recorded")
        if then != version:
            yield f"{name} was {then} and is {version}."


def _columns_of(path: Path) -> dict[str, list[Any]]:
    """The columns of a table, arrays, or values of JSON, by name."""
    if path.suffix == ".csv":
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        return {name: [row[k] if k < len(row) else "" for row in rows[1:]] for k, name in enumerate(rows[0])}
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


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of nested tables with its keys; the items of a list share a name."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _leaves(part, f"{name}.{key}" if name else key)
    elif isinstance(value, list):
        for part in value:
            yield from _leaves(part, name)
    else:
        yield name, value


def _differences(file: str, old: dict[str, list[Any]], new: dict[str, list[Any]]) -> Iterator[Difference]:
    """The largest difference of each column that differs."""
    for name in dict.fromkeys([*old, *new]):
        was, now = old.get(name), new.get(name)
        if was is None or now is None or len(was) != len(now):
            sizes = ["absent" if column is None else f"{len(column)} values" for column in (was, now)]
            yield Difference(file, name, sizes[0], sizes[1], math.inf)
            continue
        largest = max((abs(number) for value in (*was, *now) if (number := _number(value)) is not None), default=0.0)
        pairs = [(_apart(a, b, largest), a, b) for a, b in zip(was, now, strict=True)]
        share, a, b = max(pairs, key=lambda pair: pair[0], default=(0.0, "", ""))
        if share > 0.0:
            yield Difference(file, name, _shown(a), _shown(b), share)


def _apart(a: Any, b: Any, largest: float) -> float:
    """How far two values are apart, as a share of the largest number of their column."""
    if a == b:
        return 0.0
    first, second = _number(a), _number(b)
    if first is None or second is None:
        return 0.0 if str(a) == str(b) else math.inf  # nan is nan
    return abs(second - first) / largest


def _number(value: Any) -> float | None:
    """A finite number, None for anything else; truth values are none."""
    if isinstance(value, bool) or value is None:
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
