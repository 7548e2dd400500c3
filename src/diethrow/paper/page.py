"""The page of the replication: every statement beside our result, the verdict, and its reason. It needs no network."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from ..replay.elements import IMPACT, MEASURED, SIMULATED, hex_colour
from ..replay.pages import STYLE
from .results import Picture, Result, Table, Verdict, cell

COLOURS = {
    Verdict.REPRODUCED: hex_colour(MEASURED),
    Verdict.NOT_REPRODUCED: hex_colour(SIMULATED),
    Verdict.NOT_DECIDABLE: hex_colour(IMPACT),
}
OWN_STYLE = """
.verdict .headline { margin: 0 0 .3rem; font-size: 1.05rem; }
dl { margin: .8rem 0; max-width: 42rem; } dt { font: 600 .8rem system-ui, Helvetica, Arial, sans-serif; color: var(--soft); }
dd { margin: 0 0 .6rem; }
caption { caption-side: top; text-align: left; color: var(--soft); font-size: .85rem; padding: .4rem 0; }
.wide { margin: 1rem 0; }
a { color: inherit; }
@media (max-width: 30rem) { body { padding: 1.2rem .8rem 3rem; } table { font-size: .8rem; } }
"""
TITLE = "The three-dimensional dynamics of the die throw, replicated"
SOURCE = "M. Kapitaniak, J. Strzalko, J. Grabski, T. Kapitaniak, Chaos 22, 047504 (2012)"


def page(results: Sequence[Result], folder: Path, note: str) -> str:
    """The page as HTML; the figures are read from `folder`, and `note` states version and effort."""
    parts = [
        f"<h1>{escape(TITLE)}</h1>",
        f'<p class="key">{escape(SOURCE)}</p>',
        f'<p class="key">{escape(note)}</p>',
        "<p>Each statement of the paper is compared with our result for the parameters that the paper states; none is tuned. "
        "The paper's statements are quoted, its figures are not shown.</p>",
        _overview(results),
        *(_section(result, folder) for result in results),
    ]
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(TITLE)}</title>\n<style>{STYLE}{OWN_STYLE}</style>\n</head>\n<body>",
            *parts,
            "</body>\n</html>\n",
        ]
    )


def _overview(results: Sequence[Result]) -> str:
    rows = "\n".join(
        f'<tr><td><a href="#{result.key}">{escape(result.title)}</a></td><td>{_dot(result.verdict)}'
        f"{escape(result.verdict.value)}</td></tr>"
        for result in results
    )
    return (
        '<div class="wide"><table>\n<thead><tr><th>statement</th><th>verdict</th></tr></thead>\n'
        f"<tbody>\n{rows}\n</tbody></table></div>"
    )


def _dot(verdict: Verdict) -> str:
    return f'<span class="dot" style="background:{COLOURS[verdict]}"></span>'


def _section(result: Result, folder: Path) -> str:
    colour = COLOURS[result.verdict]
    compared = (("The paper", result.stated), ("Here", result.ours))
    return "\n".join(
        [
            f'<h2 id="{result.key}">{escape(result.title)}</h2>',
            "<dl>" + "".join(f"<dt>{head}</dt><dd>{escape(text)}</dd>" for head, text in compared) + "</dl>",
            f'<div class="verdict" style="border-left-color:{colour}"><p class="headline">'
            f"{escape(result.verdict.value.capitalize())}</p><p>{escape(result.why)}</p></div>",
            *(_figure(picture, folder) for picture in result.pictures),
            *(_table(table) for table in result.tables),
        ]
    )


def _figure(picture: Picture, folder: Path) -> str:
    data = base64.b64encode((folder / picture.file).read_bytes()).decode("ascii")
    text = escape(picture.caption)
    return f'<figure><img src="data:image/png;base64,{data}" alt="{text}"><figcaption>{text}</figcaption></figure>'


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in table.header)
    body = "\n".join(_row(row) for row in table.rows)
    return (
        f'<div class="wide"><table><caption>{escape(table.caption)}</caption>\n<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def _row(values: Iterable[object]) -> str:
    return "<tr>" + "".join(f"<td>{escape(cell(value))}</td>" for value in values) + "</tr>"
