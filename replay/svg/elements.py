"""The elements of an SVG as text: strokes, words, and pictures. Lengths are CSS pixels, and within the axes units."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

import cv2
import numpy as np
from numpy.typing import NDArray

from .paths import UNITS_PER_PX

FONT_PX = 12.0
"""Size of all text without a size of its own: 9 points."""
CHARACTER = 0.6
"""Mean width of a character, as a share of the font's size: that of digits in DejaVu Sans, which is a wide font."""
ASCENT, DESCENT = 0.76, 0.22
"""How far capitals reach above the base line, and other letters below it, as shares of the font's size."""
JPEG_QUALITY = 90
"""At equal quality, WebP is half as large and takes fifty times as long to write."""
PICTURE_DENSITY = 2.0
"""Pixels of an embedded picture for each CSS pixel; a finer picture is shrunk to that."""
INK, LINE_GREY = "#3a414a", "#7d858f"
"""Of text, and of the lines and ticks of the axes."""


def text_px(text: str, size_px: float = FONT_PX) -> float:
    """About the width of a text."""
    return CHARACTER * size_px * len(text)


def unit(px: float) -> int:
    """A length in whole units."""
    return round(UNITS_PER_PX * px)


def stroke(d: str, colour: str, width_px: float, dashes_px: Sequence[float] = (), cap: str = "round") -> str:
    """A stroked path, which is given in units."""
    if not d:
        return ""
    joint = ' stroke-linecap="round" stroke-linejoin="round"' if cap == "round" else ""
    dashes = f' stroke-dasharray="{" ".join(str(unit(part)) for part in dashes_px)}"' if dashes_px else ""
    return f'<path d="{d}" stroke="{escape(colour)}" stroke-width="{unit(width_px)}"{joint}{dashes}/>'


def words(x: float, y: float, text: str, anchor: str, size_px: float = FONT_PX, colour: str = INK) -> str:
    """Text whose base line starts, ends or has its middle at a place."""
    size = f' font-size="{size_px:.1f}"' if size_px != FONT_PX else ""
    where = f' text-anchor="{anchor}"' if anchor != "start" else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{escape(colour)}"{where}{size}>{escape(text)}</text>'


def plate(x: float, base: float, text: str, size_px: float, colour: str) -> str:
    """A rounded rectangle beneath a text that starts at x."""
    pad = 0.2 * size_px
    shape = (
        f'x="{x - pad:.1f}" y="{base - ASCENT * size_px - pad:.1f}" '
        f'width="{text_px(text, size_px) + 2 * pad:.1f}" height="{ASCENT * size_px + 2 * pad:.1f}" rx="{pad:.1f}"'
    )
    return f'<rect {shape} fill="{escape(colour)}"/>'


def embedded(picture: NDArray[np.uint8], width_px: float) -> str:
    """A picture as an attribute: JPEG as a data URL, with sharp pixels where they are magnified."""
    columns = picture.shape[1]
    if columns > PICTURE_DENSITY * width_px:
        share = PICTURE_DENSITY * width_px / columns
        size = max(1, round(columns * share)), max(1, round(picture.shape[0] * share))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    if picture.ndim == 3:
        picture = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), np.uint8)
    data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    sharp = ' style="image-rendering:pixelated"' if columns < width_px else ""
    return f'href="data:image/jpeg;base64,{base64.b64encode(data).decode("ascii")}"{sharp}'


def sample(d: str, colour: str, width_px: float) -> str:
    """A stroked path outside the axes, which is given in pixels."""
    return f'<path d="{d}" stroke="{escape(colour)}" stroke-width="{width_px:.1f}" stroke-linecap="round"/>'
