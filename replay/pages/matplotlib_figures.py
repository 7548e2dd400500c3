"""Figures that matplotlib draws: those of pages that need what `SvgAxes` lacks, and all figures that are exported as files.

matplotlib is imported when the first one is drawn: its import takes longer than a report, which needs none.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from .page_parts import captioned, image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAGE_DPI = 160

SAVING_OPTIONS: dict[str, dict[str, Any]] = {
    "svg": {"metadata": {"Date": None, "Creator": None}},
    "png": {"metadata": {"Software": None}},
}
"""Options for each format: no dates and no program names, so that the same record gives the same page."""


@contextmanager
def drawing(inches: tuple[float, float]) -> Iterator[Figure]:
    """An empty figure in the style of the pages; draw and save it within the block."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    # Without a fixed salt the identifiers in an SVG are random, and two runs would give different pages.
    with rc_context(
        {"font.size": 9.0, "font.family": "DejaVu Sans", "axes.linewidth": 0.7, "svg.hashsalt": "diethrow"}
    ):
        yield Figure(figsize=inches, layout="constrained")


def captioned_plot(
    inches: tuple[float, float], draw: Callable[[Axes], object], caption: str, *, narrow: bool = False
) -> str:
    """A figure with one pair of axes, and its caption, as HTML."""
    with drawing(inches) as figure:
        draw(figure.subplots())
        return captioned(image(as_address(figure, "svg"), caption), caption, narrow=narrow)


def as_address(figure: Figure, kind: str) -> str:
    """The figure as a data URL of an `svg` (with text as outlines, so that it looks the same everywhere) or a `png`."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, dpi=PAGE_DPI, **SAVING_OPTIONS[kind])
    media = "svg+xml" if kind == "svg" else kind
    return f"data:image/{media};base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
