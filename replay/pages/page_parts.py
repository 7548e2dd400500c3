"""The parts of all pages: the style sheet, plots, captions and tables. A page needs no network."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from ..elements import MEASURED, SIMULATED, UNKNOWN, WHITE, hex_colour, mixed
from ..figures import AXIS_GREY
from ..svg import INK, LINE_GREY, SvgAxes

WIDE = 8.4
"""Width of a figure across the page's text [inches]."""

STYLE = (
    """
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
.wide > img, .wide > svg { display: block; width: 100%; height: auto; }
.row { display: flex; gap: .5rem; } .row > svg { flex: 1; min-width: 0; }
svg { font-family: system-ui, "Segoe UI", Helvetica, Arial, "DejaVu Sans", sans-serif; }
figure.narrow { max-width: 30rem; }
figcaption { color: var(--soft); font-size: .85rem; line-height: 1.4; margin-top: .4rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .35rem .7rem .35rem 0; border-bottom: 1px solid var(--rule); vertical-align: top; }
th { color: var(--soft); font-weight: 600; font-size: .8rem; }
ul { padding-left: 1.2rem; max-width: 42rem; }
li { margin: .3rem 0; }
.matrix { width: auto; font-size: .75rem; } .matrix th { font-size: .75rem; }
.matrix td, .matrix thead th { min-width: 2.3rem; padding: .3rem .2rem; text-align: center; border: 0; }
.matrix td:empty { background: var(--wash); }
.matrix tbody th { padding: .3rem .6rem .3rem 0; border: 0; }
.unknown { color: var(--soft); font-style: italic; }
.dot { display: inline-block; width: .7em; height: .7em; border-radius: 50%; margin: 0 .35em 0 0; }
.dot ~ .dot { margin-left: 1.1em; }
table.facts td { overflow-wrap: anywhere; } table.facts td:first-child { color: var(--soft); width: 9rem; }
.hash { min-width: 15rem; font-family: ui-monospace, "DejaVu Sans Mono", monospace; font-size: .78rem; overflow-wrap: anywhere; }
pre { overflow-x: auto; padding: .8rem 1rem; background: var(--wash); font-size: .8rem; }
summary { cursor: pointer; } .references { font-size: .88rem; padding-left: 1.4rem; }
.downloads { columns: 16rem; } a { color: MEASURED; }
.shares { display: flex; height: .8rem; max-width: 26rem; margin: .25rem 0; } .shares i { display: block; }
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #e4e7eb; --soft: #a3acb8; --rule: #3a414a; --paper: #15181c; --wash: #20252b; color-scheme: dark; }
  svg [fill="INK"] { fill: var(--ink); } svg :is([stroke="LINE_GREY"], [stroke="AXIS_GREY"]) { stroke: var(--soft); }
  .matrix td[style] { color: #1d2126; } }
@media (max-width: 40rem) { body { padding-top: 1.2rem; } h1 { font-size: 1.4rem; }
  figure:not(.narrow) .wide > :is(img, svg, .row) { width: 40rem; max-width: none; }
  .wide > table:not(.facts, .matrix) { min-width: 34rem; } }
@media print { @page { margin: 16mm 15mm; } body { max-width: none; padding: 0; font-size: 10pt; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; } .screen { display: none; }
  h2 { break-after: avoid; margin-top: 1.6rem; } tr, li { break-inside: avoid; } .wide { overflow: visible; }
  figure { margin: .8rem 0; } figure.narrow { max-width: 11cm; } table { font-size: .82rem; } }
""".replace("MEASURED", hex_colour(MEASURED))
    .replace("INK", INK)
    .replace("LINE_GREY", LINE_GREY)
    .replace("AXIS_GREY", AXIS_GREY)
)

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


def plotted(inches: tuple[float, float], draw: Callable[[SvgAxes], object], alt: str) -> str:
    """A plot as an `<svg>` element; `alt` describes it to those who do not see it."""
    ax = SvgAxes(inches)
    draw(ax)
    return ax.svg(alt)


def captioned(content: str, caption: str, *, narrow: bool = False) -> str:
    """A plot, an image or a table, as HTML, with its caption."""
    kind = ' class="narrow"' if narrow else ""
    return f'<figure{kind}><div class="wide">{content}</div><figcaption>{escape(caption)}</figcaption></figure>'


def image(address: str, alt: str) -> str:
    """An image (a data URL) as HTML."""
    return f'<img src="{address}" alt="{escape(alt)}">'


def matrix_table(values: NDArray[np.float64], names: Sequence[str]) -> str:
    """Numbers (n, n) between -1 and 1 in hundredths, on the colours of measured (1) and simulated (-1); none on the diagonal."""
    head = "<th></th>" + "".join(f'<th scope="col">{escape(name)}</th>' for name in names)
    rows = [
        f'<tr><th scope="row">{escape(name)}</th>'
        + "".join("<td></td>" if k == row else _shaded(float(value)) for k, value in enumerate(values[row]))
        + "</tr>"
        for row, name in enumerate(names)
    ]
    body = "\n".join(rows)
    return f'<table class="matrix">\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table>'


def _shaded(value: float) -> str:
    if not np.isfinite(value):
        return "<td>–</td>"
    colour = hex_colour(mixed(WHITE, MEASURED if value > 0.0 else SIMULATED, min(abs(value), 1.0)))
    # Through `round`, so that no cell says −0.
    return f'<td style="background:{colour}">{str(round(100.0 * value)).replace("-", "−")}</td>'


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
