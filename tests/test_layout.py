"""Laws of the sources: short files, short argument lists, and the words of the glossary."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILES = [
    file for top in ("model", "tracking", "fitting", "replay", "src") for file in sorted((ROOT / top).rglob("*.py"))
]
MAX_LINES = 610
"""A file that covers one subject fits into this many lines, the longest compiled loops included."""
MAX_ARGUMENTS = 8
PRIVATE_WORDS = re.compile(
    r"\b(foretold|foretells?|borne|rivals?|parted|strays?|outset|rubs?|lively|spared|chase[ds]?|sightings)\b",
    re.IGNORECASE,
)
"""Words that a reader from the field would have to guess; the glossary has the standard terms."""


def functions() -> Iterator[tuple[str, int, bool]]:
    """Name, number of positional arguments, and whether the function is compiled."""
    for file in FILES:
        if "cli" in file.parts:  # the arguments of a command are its options
            continue
        tree = ast.parse(file.read_text(encoding="utf-8"))
        compiled = any(isinstance(node, ast.ImportFrom) and "compiled" in str(node.module) for node in tree.body)
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                count = len(node.args.posonlyargs) + len(node.args.args)
                yield f"{file.relative_to(ROOT)}:{node.name}", count, compiled


def test_files_are_short() -> None:
    assert [file.name for file in FILES if len(file.read_text(encoding="utf-8").splitlines()) > MAX_LINES] == []


def test_functions_take_few_arguments() -> None:
    assert [name for name, count, compiled in functions() if count > MAX_ARGUMENTS and not compiled] == []


def test_kernels_take_few_arguments() -> None:
    assert [name for name, count, compiled in functions() if count > MAX_ARGUMENTS and compiled] == []


def test_sources_use_the_words_of_the_glossary() -> None:
    found = [
        f"{file.relative_to(ROOT)}:{number}: {match.group()}"
        for file in FILES
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), start=1)
        for match in PRIVATE_WORDS.finditer(line)
    ]
    assert found == []
