"""`diethrow rerun`: repeat the run that made a folder of results, and compare every number.

`provenance.json` states the command, the folder in which it was given, and the digest of every input. The run is repeated
beside the old results and removed; only the comparison remains. On the same machine with the same version all numbers agree
bit by bit. Elsewhere the last digits may differ; `within` is the largest difference that counts as agreement.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ... import __version__
from ...files.csv_and_json import read_json
from ...files.provenance import package_versions, sha256, this_place
from ...model.errors import InputError
from .folder_comparison import Difference, compare

WITHIN = 1e-6
"""Largest difference that counts as rounding on another machine, as a share of the largest number of the column."""
MAX_LISTED = 10
"""Differences that a summary lists."""


@dataclass(frozen=True)
class Comparison:
    """A repeated run compared with the first one."""

    same: tuple[str, ...]
    """Files that are the same bit by bit."""
    differences: tuple[Difference, ...]
    """The largest difference of each column that differs."""
    within: float
    """Largest difference that counts as agreement."""
    notices: tuple[str, ...]
    """Changes of the version and of packages since, one sentence each."""

    @property
    def agree(self) -> bool:
        """Whether no number differs by more than `within`."""
        return all(difference.share <= self.within for difference in self.differences)


def refuse(options: list[str]) -> bool:
    """Accept no options of others."""
    return False


def rerun(folder: Path, *, within: float = WITHIN, accept: Callable[[list[str]], bool] = refuse) -> Comparison:
    """Repeat the run that made `folder`, and compare the results.

    `accept` is asked whether options that were given on another machine, or by another user, may be used here. Raises
    FileNotFoundError without provenance. Raises ValueError if the provenance names no command that can be repeated, its options
    are not accepted, an input has changed, or the repeated run fails.
    """
    folder = Path(folder).resolve()
    origin = read_json(folder / "provenance.json")
    arguments, start_folder = _command_of(origin, folder)
    options = arguments[next((k for k, word in enumerate(arguments) if word.startswith("-")), len(arguments)) :]
    if options and origin.get("made_on") != this_place() and not accept(options):
        raise InputError(
            f"{folder} was made on another machine or by another user, with {' '.join(options)}; nothing was run: give --yes to "
            "use these options here"
        )
    _check_inputs(origin, start_folder, folder)
    with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", suffix=".again", dir=folder.parent) as parent:
        repeated = Path(parent) / folder.name
        _run([*arguments, "--out", str(repeated)], start_folder, folder)
        same, differences = compare(folder, repeated)
    return Comparison(same, differences, within, tuple(_notices(origin)))


def summary(comparison: Comparison) -> list[str]:
    """The notices, the largest differences, and the result, one line each."""
    lines = list(comparison.notices)
    differences = sorted(comparison.differences, key=lambda each: -each.share)
    lines += [each.sentence for each in differences[:MAX_LISTED]]
    if len(differences) > MAX_LISTED:
        lines.append(f"and {len(differences) - MAX_LISTED} more columns")
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
    """The arguments of the command without its output, and the folder in which it was given. Raises ValueError."""
    try:
        words = [str(word) for word in origin["command"]]
        start_folder = Path(origin["folder"])
    except (KeyError, TypeError) as error:
        raise InputError(
            f"{folder}: provenance.json does not state command and folder; wanted results of diethrow"
        ) from error
    arguments, places = _without(words[1:], "--out")
    if not arguments or not places:
        raise InputError(
            f"{folder}: provenance.json names no command that can be repeated: wanted one with --out, got {words}"
        )
    # The numbers are the same on every scheduler, and a folder from elsewhere must not make this machine call another.
    arguments, _ = _without(arguments, "--scheduler")
    return [word for word in arguments if word not in ("--force", "--resume")], start_folder


def _without(words: list[str], option: str) -> tuple[list[str], list[str]]:
    """The words without an option, and its values: `--option VALUE` or `--option=VALUE`."""
    kept: list[str] = []
    values: list[str] = []
    left = iter(words)
    for word in left:
        if word == option:
            values += [value for value in [next(left, None)] if value is not None]
        elif word.startswith(f"{option}="):
            values.append(word.partition("=")[2])
        else:
            kept.append(word)
    return kept, values


def _check_inputs(origin: Any, start_folder: Path, folder: Path) -> None:
    """Raises ValueError for an input that is missing or has changed."""
    for each in origin["inputs"]:
        path = start_folder / each["path"]
        if not path.is_file():
            raise InputError(f"{folder} cannot be repeated: {path} is missing; put it back")
        if path.stat().st_size != each["bytes"] or sha256(path) != each["sha256"]:
            raise InputError(f"{folder} cannot be repeated: {path} has changed since; put the old file back")


def _run(arguments: list[str], start_folder: Path, folder: Path) -> None:
    """Run the command in a process of its own, so that nothing loaded in this one affects it."""
    if not start_folder.is_dir():
        raise InputError(f"{folder} cannot be repeated: the folder of its command, {start_folder}, is missing")
    program = "from diethrow.cli import main; main()"
    result = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        cwd=start_folder,
        env={**os.environ, "COLUMNS": str(shutil.get_terminal_size().columns)},
        capture_output=True,
        text=True,
        check=False,
    )
    # A check exits with status 1 for a bad finding as well, so the output decides whether the run failed.
    if not Path(arguments[-1]).exists():
        lines = result.stderr.strip().splitlines() or [f"status {result.returncode} without a message"]
        raise InputError(f"{folder} cannot be repeated: {lines[-1].removeprefix('diethrow: ')}")


def _notices(origin: Any) -> Iterator[str]:
    if origin["diethrow"] != __version__:
        yield f"Version {origin['diethrow']} made the results; this is {__version__}."
    for name, version in package_versions().items():
        then = origin["packages"].get(name, "not recorded")
        if then != version:
            yield f"{name} was {then} and is {version} now."
