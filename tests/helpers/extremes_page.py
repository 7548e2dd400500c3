"""The page of the tests at the limits: one row for each law, and in it one line for each limit."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import pytest

COMMAND = "python -m pytest tests/extremes --slow --extremes-page docs/extremes.md"
HEAD = f"""# Stability at the extremes

Each stage at its limits: the expectation and the result. *Given up* means an error or a message in one sentence, never a pose
or a number that the frames do not determine. Every row is a test, which fails if the expectation does not hold; tests marked
*slow* run with `--slow` only. This page was written by

```sh
{COMMAND}
```
"""
ORDER = ("model", "footage", "tracking", "bounces_and_fits", "records")
"""Order of the files on the page: the order of the stages."""
SECTION = re.compile(r"^# -{4,} (.+?) -+$")
"""A heading among the tests of a file."""


@dataclass(frozen=True)
class Ran:
    """One test that was run or skipped."""

    file: str
    line: int
    name: str
    """Name of the function, without the parameters."""
    limit: str
    """Id of the parameters; empty for a test without parameters."""
    outcome: str
    """`passed`, `failed`, `skipped`, or the reason of an expected failure."""
    stage: str
    expected: str
    happened: tuple[str, ...]
    slow: bool

    @staticmethod
    def from_report(report: pytest.TestReport) -> Ran:
        """The test of a report."""
        file, line, _ = report.location
        name, _, limit = report.nodeid.rpartition("::")[2].partition("[")
        properties = dict(report.user_properties)
        happened = tuple(str(text) for key, text in report.user_properties if key == "happened")
        outcome = f"not as expected: {report.wasxfail}" if hasattr(report, "wasxfail") else report.outcome
        return Ran(
            file, line or 0, name, limit.removesuffix("]"), outcome, str(properties.get("stage", "")),
            str(properties.get("expected", "")), happened, bool(properties.get("slow")),
        )  # fmt: skip


class PageOfExtremes:
    """A pytest plugin that collects the reports and writes the page at the end of the session."""

    def __init__(self, path: Path, root: Path) -> None:
        self._path, self._root = path, root
        self._ran: list[Ran] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Collect one report per test; a test that is skipped, or fails in its setup, has no `call` phase."""
        if report.when == "call" or (report.when == "setup" and report.outcome != "passed"):
            self._ran.append(Ran.from_report(report))

    def pytest_sessionfinish(self) -> None:
        """Write the page, with the tests in the order of their files."""
        ran = sorted(self._ran, key=lambda one: (_place(one.file), one.line))
        self._path.write_text(page(self._root, ran), encoding="utf-8")


def page(root: Path, ran: Sequence[Ran]) -> str:
    """The page as Markdown."""
    parts = [HEAD]
    for _, tests in groupby((one for one in ran if one.expected), key=lambda one: one.file):
        of_file = list(tests)
        title, _, limits = sentence(of_file[0].stage).partition(": ")
        parts += [f"## {title}\n\n{limits[:1].upper()}{limits[1:]}.\n", table(("expected", "happened"), _rows(of_file))]
    laws = [one for one in ran if not one.expected and one.outcome != "skipped"]
    if laws:
        parts += [
            f"## The model's own laws\n\n{len(laws)} cases, by what they ask.\n",
            table(("laws", "cases", "held"), _laws(root, laws)),
        ]
    return "\n".join(parts)


def sentence(docstring: str) -> str:
    """The first paragraph of a docstring in one line, without its full stop."""
    return " ".join(docstring.split("\n\n")[0].split()).removesuffix(".")


def table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown."""
    cells = [list(header), *(list(row) for row in rows)]
    cells.insert(1, ["---"] * len(cells[0]))
    return "\n".join(f"| {' | '.join(text.replace('|', chr(92) + '|') for text in row)} |" for row in cells) + "\n"


def _place(file: str) -> tuple[int, str]:
    name = Path(file).stem.removeprefix("test_")
    return (ORDER.index(name) if name in ORDER else len(ORDER), file)


def _rows(tests: Sequence[Ran]) -> list[tuple[str, str]]:
    """One row for each function."""
    rows = []
    for _, alike in groupby(tests, key=lambda one: one.line):
        of_law = list(alike)
        rows.append((sentence(of_law[0].expected), "<br>".join(_line(one) for one in of_law)))
    return rows


def _line(one: Ran) -> str:
    """The result at one limit."""
    limit = f"**{one.limit}**{' (slow)' if one.slow else ''}: " if one.limit else "(slow) " if one.slow else ""
    if one.outcome == "skipped":
        return f"{limit}not run this time"
    happened = "; ".join(one.happened)
    return limit + (happened if one.outcome == "passed" else f"**{one.outcome}** {happened}".strip())


def _laws(root: Path, tests: Sequence[Ran]) -> list[tuple[str, str, str]]:
    """One row for each section of a file: its laws by name."""
    rows = []
    for (file, heading), alike in groupby(tests, key=lambda one: (one.file, _heading(root / one.file, one.line))):
        of_section = list(alike)
        names = dict.fromkeys(one.name.removeprefix("test_").replace("_", " ") for one in of_section)
        held = sum(one.outcome == "passed" for one in of_section)
        rows.append((f"**{heading or file}**: {'; '.join(names)}", str(len(of_section)), str(held)))
    return rows


def _heading(path: Path, line: int) -> str:
    """The last heading before a line."""
    above = path.read_text(encoding="utf-8").splitlines()[: line + 1]
    found = [match[1] for text in above if (match := SECTION.match(text))]
    return found[-1] if found else ""
