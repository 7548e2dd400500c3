"""The parts that every page is made of: one style, figures as data addresses, tables. A page needs no network."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from html import escape

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .palette import MEASURED, hex_colour
from .words import UNKNOWN

STYLE = """
:root { --ink: #1d2126; --soft: #5b6470; --rule: #d9dde2; --paper: #fff; --wash: #f5f6f8; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 54rem; padding: 2.2rem 1.2rem 4rem; background: var(--paper); color: var(--ink);
  font: 1rem/1.55 "Source Serif 4", Charter, Georgia, "DejaVu Serif", serif; }
h1, h2, th, figcaption, .key { font-family: system-ui, "Segoe UI", Helvetica, Arial, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; overflow-wrap: anywhere; }
h2 { font-size: 1.1rem; margin: 2.6rem 0 .6rem; padding-top: .8rem; border-top: 1px solid var(--rule); }
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
@media print { body { max-width: none; padding: 0; font-size: 10pt; }
  .wide { overflow: visible; } h2 { break-after: avoid; } }
""".replace("MEASURED", hex_colour(MEASURED))


def whole_page(title: str, parts: Iterable[str], style: str = "") -> str:
    """A page of finished parts; `style` is added to that of all pages."""
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}</title>\n<style>{STYLE}{style}</style>\n</head>\n<body>",
            *parts,
            "</body>\n</html>\n",
        ]
    )


def plotted(inches: tuple[float, float], draw: Callable[[Axes], Axes]) -> str:
    """One pair of axes as a data address."""
    with drawing(inches) as figure:
        ax = draw(figure.subplots())
        if ax.get_legend_handles_labels()[0] and ax.get_legend() is None:
            ax.legend(loc="upper right", frameon=False)
        return as_address(figure, "svg")


@contextmanager
def drawing(inches: tuple[float, float]) -> Iterator[Figure]:
    """An empty figure in the report's own style; drawing and writing happen inside."""
    # Without a salt the names inside an SVG are random, and the same record would give another page each time.
    with rc_context(
        {"font.size": 9.0, "font.family": "DejaVu Sans", "axes.linewidth": 0.7, "svg.hashsalt": "diethrow"}
    ):
        figure = Figure(figsize=inches, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure


def as_address(figure: Figure, kind: str) -> str:
    """The figure as a data address; text as outlines, so that it looks the same everywhere."""
    buffer = io.BytesIO()
    nothing = {"Date": None, "Creator": None} if kind == "svg" else {"Software": None}
    figure.savefig(buffer, format=kind, dpi=160, metadata=nothing)
    media = "image/svg+xml" if kind == "svg" else "image/png"
    return f"data:{media};base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def captioned(address: str, caption: str, *, narrow: bool = False) -> str:
    kind = ' class="narrow"' if narrow else ""
    text = escape(caption)
    return f'<figure{kind}><img src="{address}" alt="{text}"><figcaption>{text}</figcaption></figure>'


def as_table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "\n".join("<tr>" + "".join(_cell(cell) for cell in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>'


def _cell(text: str) -> str:
    kind = ' class="unknown"' if text.startswith(UNKNOWN) else ""
    return f"<td{kind}>{escape(text)}</td>"
