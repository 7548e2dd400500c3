"""The parts of all pages: the style sheet, figures as data URLs, captions and tables. A page needs no network."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from html import escape
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..elements import MEASURED, UNKNOWN, hex_colour

WIDE = 8.4
"""Width of a figure across the page's text [inches]."""
PAGE_DPI = 160

STYLE = """
:root { --ink: #1d2126; --soft: #5b6470; --rule: #d9dde2; --paper: #fff; --wash: #f5f6f8; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 54rem; padding: 2.2rem 1.2rem 4rem; background: var(--paper); color: var(--ink);
  font: 1rem/1.55 "Source Serif 4", Charter, Georgia, "DejaVu Serif", serif; }
h1, h2, h3, th, figcaption, .key { font-family: system-ui, "Segoe UI", Helvetica, Arial, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; overflow-wrap: anywhere; }
h2 { font-size: 1.1rem; margin: 2.6rem 0 .6rem; padding-top: .8rem; border-top: 1px solid var(--rule); }
h3 { font-size: .95rem; margin: 1.8rem 0 .4rem; }
p { margin: .5rem 0; max-width: 42rem; }
.key { color: var(--soft); font-size: .85rem; }
.verdict { margin: 1.2rem 0; padding: .8rem 1.1rem; background: var(--wash); border-left: 4px solid MEASURED; }
.headline { font-family: system-ui, Helvetica, Arial, "DejaVu Sans", sans-serif; font-size: 1.25rem; font-weight: 600; }
figure { margin: 1.2rem 0; break-inside: avoid; }
figure img { display: block; width: 100%; height: auto; }
figure.narrow { max-width: 30rem; }
figcaption { color: var(--soft); font-size: .85rem; line-height: 1.4; margin-top: .4rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .35rem .7rem .35rem 0; border-bottom: 1px solid var(--rule); vertical-align: top; }
th { color: var(--soft); font-weight: 600; font-size: .8rem; }
ul { padding-left: 1.2rem; max-width: 42rem; }
li { margin: .3rem 0; }
.unknown { color: var(--soft); font-style: italic; }
.dot { display: inline-block; width: .7em; height: .7em; border-radius: 50%; margin: 0 .35em 0 0; }
.dot ~ .dot { margin-left: 1.1em; }
table.facts td { overflow-wrap: anywhere; } table.facts td:first-child { color: var(--soft); width: 9rem; }
.hash { min-width: 15rem; font-family: ui-monospace, "DejaVu Sans Mono", monospace; font-size: .78rem; overflow-wrap: anywhere; }
@media (max-width: 40rem) { body { padding-top: 1.2rem; } h1 { font-size: 1.4rem; }
  figure:not(.narrow) .wide img { width: 36rem; max-width: none; } .wide > table:not(.facts) { min-width: 34rem; } }
@media print { @page { margin: 16mm 15mm; } body { max-width: none; padding: 0; font-size: 10pt; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; } .screen { display: none; }
  h2 { break-after: avoid; margin-top: 1.6rem; } tr, li { break-inside: avoid; } .wide { overflow: visible; }
  figure { margin: .8rem 0; } figure.narrow { max-width: 11cm; } table { font-size: .82rem; } }
""".replace("MEASURED", hex_colour(MEASURED))

SAVING_OPTIONS: dict[str, dict[str, Any]] = {
    "svg": {"metadata": {"Date": None, "Creator": None}},
    "png": {"metadata": {"Software": None}},
    "webp": {"pil_kwargs": {"quality": 88}},
}
"""Options for each format: no dates and no program names, so that the same record gives the same page."""

STATIC_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""Content security policy of a page without scripts: the browser then refuses every network access."""


def whole_page(title: str, parts: Iterable[str], style: str = "", policy: str = STATIC_POLICY) -> str:
    """A page made of finished parts.

    `style` is added to the common style sheet; `policy` is the content security policy.
    """
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}</title>\n<style>{STYLE}{style}</style>\n</head>\n<body>",
            *parts,
            "</body>\n</html>\n",
        ]
    )


def plotted(inches: tuple[float, float], draw: Callable[[Axes], Axes]) -> str:
    """A figure with one pair of axes as a data URL."""
    with drawing(inches) as figure:
        legended(draw(figure.subplots()))
        return as_address(figure, "svg")


def legended(ax: Axes) -> Axes:
    """The axes, with a legend if something on them has a label and there is no legend yet."""
    if ax.get_legend_handles_labels()[0] and ax.get_legend() is None:
        ax.legend(loc="upper right", frameon=False)
    return ax


@contextmanager
def drawing(inches: tuple[float, float]) -> Iterator[Figure]:
    """An empty figure in the style of the pages; draw and save it within the block."""
    # Without a fixed salt the identifiers in an SVG are random, and two runs would give different pages.
    with rc_context(
        {"font.size": 9.0, "font.family": "DejaVu Sans", "axes.linewidth": 0.7, "svg.hashsalt": "diethrow"}
    ):
        yield Figure(figsize=inches, layout="constrained")


def as_address(figure: Figure, kind: str) -> str:
    """The figure as a data URL of an `svg` (with text as outlines, so that it looks the same everywhere), `png` or `webp`.

    WebP needs a fifth of PNG's size for photographs.
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, dpi=PAGE_DPI, **SAVING_OPTIONS[kind])
    media = "svg+xml" if kind == "svg" else kind
    return f"data:image/{media};base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def captioned(address: str, caption: str, *, narrow: bool = False) -> str:
    """An image (a data URL) with its caption."""
    kind = ' class="narrow"' if narrow else ""
    text = escape(caption)
    picture = f'<div class="wide"><img src="{address}" alt="{text}"></div>'
    return f"<figure{kind}>{picture}<figcaption>{text}</figcaption></figure>"


def key_value_table(rows: Iterable[tuple[str, str]]) -> str:
    """A table of names and texts, without a header."""
    body = "\n".join(f"<tr>{_cell(name)}{_cell(text)}</tr>" for name, text in rows)
    return f'<div class="wide"><table class="facts">\n<tbody>\n{body}\n</tbody></table></div>'


def as_table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Rows of text below a header; cells that begin with `not determined` are in grey italics."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "\n".join("<tr>" + "".join(_cell(cell) for cell in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>'


def _cell(text: str) -> str:
    kind = ' class="unknown"' if text.startswith(UNKNOWN) else ""
    return f"<td{kind}>{escape(text)}</td>"
