"""The list of the pages on methods: every page of this folder that is about one, whoever wrote it."""

from __future__ import annotations

from pathlib import Path

FIRST = ("model", "tracking", "fitting", "replay")
OTHERS = (
    "index",
    "tutorial",
    "scene",
    "results",
    "accuracy",
    "glossary",
    "api",
    "comparison",
    "methods",
    "phone",
    "equipment",
)
"""Pages that are about something else."""


def write(folder: Path) -> None:
    """`methods.md`, with the four stages first and every further page after them."""
    further = sorted(page.stem for page in folder.glob("*.md") if page.stem not in (*FIRST, *OTHERS))
    names = [name for name in FIRST if (folder / f"{name}.md").exists()] + further
    listed = "\n".join(names)
    text = "# Methods\n\nWhat is done, on what it rests, and what was measured.\n"
    text += f"\n```{{toctree}}\n:maxdepth: 2\n\n{listed}\n```\n"
    path = folder / "methods.md"
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
