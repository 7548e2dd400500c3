"""A page for every command, made from the command line itself: nothing of it is copied by hand.

In the notes, `{presets}` stands for the table of the presets of `film`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from diethrow.cli.app import app
from diethrow.commands.model.film_presets import PRESETS


def write(folder: Path) -> None:
    """`NAME.md` for every command and `index.md` for all; what stands in `notes/NAME.md` follows the options."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    for name, command in commands.items():
        _write(folder / f"{name}.md", _page(name, command, folder / "notes" / f"{name}.md"))
    _write(folder / "index.md", _index(commands))


def _write(path: Path, text: str) -> None:
    # An unchanged page keeps its time, so that Sphinx does not read it again.
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _index(commands: dict[str, Any]) -> str:
    rows = [f"| [`diethrow {name}`]({name}.md) | {_first_sentence(command)} |" for name, command in commands.items()]
    names = "\n".join(commands)
    return (
        "# Commands\n\n| command | does |\n| --- | --- |\n"
        + "\n".join(rows)
        + "\n\n`diethrow -v COMMAND` logs every stage with its time, `diethrow -q COMMAND` leaves out progress and notes; both "
        "on standard error, through the logger `diethrow` of Python's `logging`. `--json` prints the result of a command as JSON "
        "on standard output. `diethrow --install-completion` teaches the shell commands, options and choices.\n"
        + "\nThe exit status is 0 for a result, 1 for a run without one, 2 for a mistake in a file or on the command line, "
        "and 130 after Ctrl-C. Errors are one sentence; `DIETHROW_TRACEBACK=1` shows where they came from.\n"
        f"\n```{{toctree}}\n:hidden:\n\n{names}\n```\n"
    )


def _first_sentence(command: Any) -> str:
    return str(command.help).strip().split("\n\n")[0].replace("\n", " ")


def _page(name: str, command: Any, notes: Path) -> str:
    context = command.context_class(command, info_name=f"diethrow {name}")
    records = [(p.param_type_name, p.get_help_record(context)) for p in command.params]
    usage = command.get_usage(context).removeprefix("Usage: ")
    parts = [f"# diethrow {name}", str(command.help).strip(), f"```text\n{usage}\n```"]
    if command.epilog:
        parts.append(f"```text\n{str(command.epilog).strip()}\n```")
    for kind, heading in (("argument", "## Arguments"), ("option", "## Options")):
        rows = [record for of_kind, record in records if of_kind == kind and record is not None]
        if rows:
            parts += [heading, _table(rows)]
    if notes.exists():
        parts.append(notes.read_text(encoding="utf-8").strip().replace("{presets}", _presets()))
    return "\n\n".join(parts) + "\n"


def _presets() -> str:
    """The presets of `film` with what they set."""
    lines = ["| preset | film | settings |", "| --- | --- | --- |"]
    for preset in PRESETS:
        values = ", ".join(f"`{name} = {value}`" for name, value in preset.values.items())
        lines.append(f"| `{preset.name}` | {_cell(preset.sentence)} | {values} |")
    return "\n".join(lines)


def _table(rows: list[tuple[str, str]]) -> str:
    return "\n".join(["| | |", "| --- | --- |", *(f"| `{_cell(names)}` | {_cell(text)} |" for names, text in rows)])


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", r"\|")
