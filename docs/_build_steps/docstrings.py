"""Docstrings as reStructuredText: they are written to be read in an editor, with formulas and tables as plain text."""

from __future__ import annotations

import re
from typing import Any

SPECIAL = re.compile(r"([*|\\]|(?<=\w)_(?!\w))")
"""What reStructuredText would take for emphasis, a substitution or a reference."""
BOLD = re.compile(r"(\*\*\w[^*`]*\*\*)")


def as_rest(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Blocks that are indented, tables and drawings stay as they are; all else is prose, `code` and lists."""
    blocks, written = "\n".join(lines).strip("\n").split("\n\n"), []
    for block in blocks:
        rows = [row for row in block.split("\n") if row.strip()]
        if not rows:
            continue
        written += [*_literal(rows), ""] if _is_figure(rows) else [*_prose(rows), ""]
    lines[:] = written


def _is_figure(rows: list[str]) -> bool:
    """Whether the block is set out by hand: all of it indented, or a table."""
    return all(row.startswith((" ", "\t")) for row in rows) or all(row.lstrip().startswith("|") for row in rows)


def _literal(rows: list[str]) -> list[str]:
    return ["::", "", *(f"    {row.rstrip()}" for row in rows)]


def _prose(rows: list[str]) -> list[str]:
    """One paragraph, or one item a bullet; what stands between backticks is code."""
    items: list[str] = []
    for row in rows:
        begins = row.lstrip().startswith("- ")
        if begins or not items:
            items.append(row.strip())
        else:
            items[-1] += f" {row.strip()}"
    # A paragraph that leads up to a list is apart from it.
    spaced = [
        line for k, item in enumerate(items) for line in ([""] if k == 1 and item.startswith("- ") else []) + [item]
    ]
    return [_escaped(item) for item in spaced]


def _escaped(text: str) -> str:
    parts = text.split("`")
    return "".join(f"``{part}``" if k % 2 else _escaped_prose(part) for k, part in enumerate(parts))


def _escaped_prose(text: str) -> str:
    """What is bold stays so."""
    return "".join(part if k % 2 else SPECIAL.sub(r"\\\1", part) for k, part in enumerate(BOLD.split(text)))
