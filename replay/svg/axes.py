"""One plot as SVG, drawn with matplotlib's methods.

Calls collect marks; `svg` then finds limits and margins and writes all of it. Lengths inside are CSS pixels; arguments in points
and inches are converted at the door. The width of a text is estimated, since the reader's browser chooses the font.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .elements import ASCENT, DESCENT, FONT_PX, INK, LINE_GREY, embedded, plate, stroke, text_px, unit, words
from .legend import Handle, Legend
from .paths import UNITS_PER_PX, curve, dots, steps_after
from .scales import Box, Scale

Array = NDArray[np.float64]

PX_PER_INCH = 96.0
PX_PER_POINT = PX_PER_INCH / 72.0
TICK_PX = 4.0
PAD_PX = 4.0
"""Between ticks, their numbers, and the name of the axis."""
EDGE_PX = 7.0
"""Free space at the edges of the picture: half of a number that stands at the end of an axis."""
DOT_EDGE_POINTS = 1.0
"""matplotlib draws this edge around markers, which makes them that much wider."""
X_TICK_PX, Y_TICK_PX = 50.0, 36.0
"""Smallest mean distance of ticks."""
LAYOUT_PASSES = 2
"""The margins depend on the ticks, and these on the space that the margins leave; the second pass settles it."""

Mark = Callable[[Box], str]
"""Writes something in the box, in units of 1 / UNITS_PER_PX px."""


class Spines:
    """The lines around the data, by name."""

    def __init__(self) -> None:
        self.hidden: set[str] = set()

    def __getitem__(self, names: list[str] | slice) -> ChosenSpines:
        every = ["left", "bottom", "top", "right"]
        return ChosenSpines(self, every[names] if isinstance(names, slice) else names)


@dataclass(frozen=True)
class ChosenSpines:
    """Some of them."""

    spines: Spines
    names: list[str]

    def set_visible(self, visible: bool) -> None:
        """Show or hide them."""
        (self.spines.hidden.difference_update if visible else self.spines.hidden.update)(self.names)


class SvgAxes:
    """Axes that fill a picture of a given size [inches], and write it as SVG.

    The methods have the names, the arguments and the meaning of matplotlib's, and what no figure uses is missing.
    """

    def __init__(self, inches: tuple[float, float]) -> None:
        self.width, self.height = PX_PER_INCH * inches[0], PX_PER_INCH * inches[1]
        self.spines = Spines()
        self._x, self._y = Scale(), Scale()
        self._marks: list[tuple[float, Mark]] = []
        self._words: list[Callable[[Box], str]] = []
        self._handles: list[Handle] = []
        self._legend: Legend | None = None
        self._tick_px = TICK_PX
        self._equal = False

    # --- marks ---

    def plot(
        self,
        x: ArrayLike,
        y: ArrayLike,
        kind: str = "-",
        /,
        *,
        color: str,
        linewidth: float = 1.5,
        markersize: float = 6.0,
        label: str | None = None,
        zorder: float = 2.0,
        rasterized: bool = False,
    ) -> None:
        """A line (`-`), dots (`o`, or the smaller `.`), or both (`-o`). Many points are thinned, and so never `rasterized`."""
        along, up = np.atleast_1d(np.asarray(x, float)), np.atleast_1d(np.asarray(y, float))
        known = np.isfinite(along) & np.isfinite(up)
        self._x.include(along[known])
        self._y.include(up[known])
        line_px = PX_PER_POINT * linewidth if "-" in kind else 0.0
        dot_px = 0.0
        if kind[-1] in "o.":
            dot_px = PX_PER_POINT * ((markersize if kind[-1] == "o" else 0.5 * markersize) + DOT_EDGE_POINTS)
        if line_px:
            self._add(zorder, lambda box: stroke(curve(*_units(box, along, up)), color, line_px))
        if dot_px:
            self._add(zorder, lambda box: stroke(dots(*_units(box, along, up)), color, dot_px))
        if label is not None:
            self._handles.append(Handle(label, color, line_px, dot_px))

    def step(
        self,
        x: ArrayLike,
        y: ArrayLike,
        kind: str = "-",
        /,
        *,
        where: Literal["post"],
        color: str,
        linewidth: float = 1.5,
        markersize: float = 6.0,
        label: str | None = None,
        zorder: float = 2.0,
    ) -> None:
        """A line that changes at each next point, with dots at the points if `kind` has them."""
        along, up = np.asarray(x, float), np.asarray(y, float)
        self.plot(*steps_after(along, up), "-", color=color, linewidth=linewidth, zorder=zorder)
        if kind[-1] in "o.":
            self.plot(along, up, kind[-1], color=color, markersize=markersize, zorder=zorder)
        if label is not None:
            dot_px = PX_PER_POINT * (markersize + DOT_EDGE_POINTS) if kind[-1] in "o." else 0.0
            self._handles.append(Handle(label, color, PX_PER_POINT * linewidth, dot_px))

    def bar(self, x: Sequence[str], height: Sequence[float], /, width: float = 0.8, *, color: str) -> None:
        """A bar from 0 for each name, at 0, 1, 2, …"""
        self.set_xticks(range(len(x)), list(x))
        self._x.include([-0.5 * width, len(x) - 1 + 0.5 * width])
        self._y.include([0.0, *height])

        def mark(box: Box) -> str:
            places = np.arange(len(x))
            left, right = box.x(places - 0.5 * width), box.x(places + 0.5 * width)
            sides = zip(left, right, box.y(height), strict=True)
            base = unit(float(box.y(0.0)))
            d = "".join(f"M{unit(a)} {base}V{unit(top)}H{unit(b)}V{base}z" for a, b, top in sides)
            return f'<path d="{d}" fill="{escape(color)}"/>'

        self._add(1.0, mark)

    def imshow(
        self,
        picture: NDArray[np.uint8],
        /,
        *,
        cmap: str = "gray",
        vmin: float = 0.0,
        vmax: float = 255.0,
        interpolation: str = "nearest",
        extent: tuple[float, float, float, float] | None = None,
    ) -> None:
        """A picture (height, width) of 8-bit grey levels, or (height, width, 3) of colours, with its pixels' centres at integers.

        `extent` states its left, right, lower and upper edge instead.
        """
        if (cmap, vmin, vmax, interpolation) != ("gray", 0.0, 255.0, "nearest") or picture.dtype != np.uint8:
            raise ValueError("SvgAxes shows pixels of 8 bits as they are")
        rows, columns = picture.shape[:2]
        left, right, bottom, top = extent or (-0.5, columns - 0.5, rows - 0.5, -0.5)
        self._x.include([left, right])
        self._y.include([bottom, top])
        self._equal = True
        if extent is None:
            self.set_xlim(left, right)
            self.set_ylim(bottom, top)

        def mark(box: Box) -> str:
            (x0, x1), (y0, y1) = np.sort(box.x([left, right])), np.sort(box.y([bottom, top]))
            shape = " ".join(
                f'{name}="{unit(value)}"'
                for name, value in zip(("x", "y", "width", "height"), (x0, y0, x1 - x0, y1 - y0), strict=True)
            )
            return f'<image {shape} preserveAspectRatio="none" {embedded(picture, x1 - x0)}/>'

        self._add(0.0, mark)

    def text(
        self,
        x: float,
        y: float,
        text: str,
        /,
        *,
        ha: str = "left",
        va: str = "baseline",
        fontsize: float = FONT_PX / PX_PER_POINT,
        color: str = INK,
        bbox: Mapping[str, Any] | None = None,
    ) -> None:
        """Text at a place of the data; `bbox` with a colour `fc` lays a rounded rectangle beneath it."""
        size = PX_PER_POINT * fontsize

        def written(box: Box) -> str:
            place = box.left + float(box.x(x)), box.top + float(box.y(y))
            below = {"top": ASCENT, "center": 0.5 * (ASCENT - DESCENT), "bottom": -DESCENT, "baseline": 0.0}[va] * size
            anchor = {"left": "start", "center": "middle", "right": "end"}[ha]
            beneath = plate(place[0], place[1] + below, text, size, str(bbox["fc"])) if bbox is not None else ""
            return beneath + words(place[0], place[1] + below, text, anchor, size, color)

        self._words.append(written)

    def axhline(self, y: float, /, *, color: str, linewidth: float, zorder: float = 2.0) -> None:
        """A horizontal line across the axes."""
        self._y.include(y)
        width = PX_PER_POINT * linewidth
        self._add(zorder, lambda box: stroke(f"M0 {unit(float(box.y(y)))}h{unit(box.width)}", color, width, cap="butt"))

    def axvline(
        self,
        x: float,
        /,
        *,
        color: str,
        linewidth: float,
        linestyle: tuple[float, tuple[float, ...]] | None = None,
        zorder: float = 2.0,
    ) -> None:
        """A vertical line across the axes; `linestyle` gives the dashes and gaps in widths of the line, after their start."""
        self._x.include(x)
        width = PX_PER_POINT * linewidth
        dashes = [width * part for part in linestyle[1]] if linestyle is not None else []
        self._add(
            zorder,
            lambda box: stroke(f"M{unit(float(box.x(x)))} 0v{unit(box.height)}", color, width, dashes, cap="butt"),
        )

    def axhspan(
        self, low: float, high: float, /, *, color: str, alpha: float, linewidth: float = 0.0, zorder: float = 1.0
    ) -> None:
        """A horizontal band across the axes, without an outline."""
        self._y.include([low, high])

        def mark(box: Box) -> str:
            upper, lower = np.sort(box.y([low, high]))
            d = f"M0 {unit(upper)}h{unit(box.width)}V{unit(lower)}H0z"
            return f'<path d="{d}" fill="{escape(color)}" fill-opacity="{alpha:g}"/>'

        self._add(zorder, mark)

    # --- axes ---

    def set_xlim(self, left: float | None = None, right: float | None = None) -> None:
        """The limits; None keeps what was."""
        self._x.low, self._x.high = (self._x.low if left is None else left), (self._x.high if right is None else right)

    def set_ylim(self, bottom: float | None = None, top: float | None = None) -> None:
        """The limits; None keeps what was."""
        self._y.low = self._y.low if bottom is None else bottom
        self._y.high = self._y.high if top is None else top

    def set_xlabel(self, xlabel: str, /) -> None:
        """The name of the axis."""
        self._x.name = xlabel

    def set_ylabel(self, ylabel: str, /) -> None:
        """The name of the axis."""
        self._y.name = ylabel

    def set_xticks(self, ticks: Iterable[float], labels: Sequence[str] | None = None) -> None:
        """The ticks, with their numbers or other texts."""
        self._x.ticks, self._x.texts = [float(tick) for tick in ticks], None if labels is None else list(labels)

    def set_yticks(self, ticks: Iterable[float], labels: Sequence[str] | None = None) -> None:
        """The ticks, with their numbers or other texts."""
        self._y.ticks, self._y.texts = [float(tick) for tick in ticks], None if labels is None else list(labels)

    def tick_params(self, *, length: float) -> None:
        """The length of the ticks."""
        self._tick_px = PX_PER_POINT * length

    def set_aspect(self, aspect: Literal["auto", "equal"], /) -> None:
        """With `equal`, a unit is as high as wide, and the picture becomes as high as that needs."""
        self._equal = aspect == "equal"

    def margins(self, *, x: float) -> None:
        """Free space beside the data, as a share of its extent."""
        self._x.margin = x

    def legend(
        self,
        *,
        loc: str,
        bbox_to_anchor: tuple[float, float],
        ncols: int = 1,
        frameon: bool = False,
        markerscale: float = 1.0,
        handletextpad: float = 0.8,
    ) -> None:
        """The names of what was drawn with a label. Space is made for a legend that stands above or to the right."""
        self._legend = Legend(tuple(self._handles), loc, bbox_to_anchor, ncols, markerscale)

    # --- the picture ---

    def svg(self, alt: str) -> str:
        """The whole picture as an `<svg>` element of HTML; `alt` describes it to those who do not see it."""
        box, bottom = self._layout()
        marks = "".join(mark(box) for _, mark in sorted(self._marks, key=lambda each: each[0]))
        size = f'width="{box.width:.1f}" height="{box.height:.1f}"'
        units = f"0 0 {unit(box.width)} {unit(box.height)}"
        # An inner <svg> cuts off what lies outside the limits, and needs no name as a clip path would.
        parts = [
            f'<svg x="{box.left:.1f}" y="{box.top:.1f}" {size} viewBox="{units}">{marks}</svg>',
            *self._frame(box),
            *(written(box) for written in self._words),
            *([self._legend.svg(box)] if self._legend is not None and self._legend.handles else []),
        ]
        return (
            f'<svg viewBox="0 0 {self.width:.0f} {box.top + box.height + bottom:.0f}" role="img" '
            f'aria-label="{escape(alt)}" fill="none" font-size="{FONT_PX:g}">{"".join(parts)}</svg>'
        )

    def _add(self, layer: float, mark: Mark) -> None:
        self._marks.append((layer, mark))

    def _layout(self) -> tuple[Box, float]:
        """The box of the data, and the space below it [px]."""
        beside = above = 0.0
        if self._legend is not None and self._legend.handles:
            width, height = self._legend.size
            beside = width + 3.0 * PAD_PX if self._legend.is_beside else 0.0
            above = height + PAD_PX if self._legend.is_above else 0.0
        outside = FONT_PX + PAD_PX
        bottom = (outside + self._tick_px if self._x.ticks != [] else 0.0) + (outside if self._x.name else 0.0) + PAD_PX
        top, right = max(above, EDGE_PX), max(beside, EDGE_PX)
        x_limits, y_limits = self._x.limits(), self._y.limits()
        height = self.height - top - bottom
        for _ in range(LAYOUT_PASSES):
            texts = self._y.shown(height, Y_TICK_PX)[1]
            left = (
                max(map(text_px, texts), default=0.0)
                + self._tick_px
                + PAD_PX
                + (outside + PAD_PX if self._y.name else 0.0)
            )
            width = self.width - max(left, EDGE_PX) - right
            if self._equal:
                height = width * abs((y_limits[1] - y_limits[0]) / (x_limits[1] - x_limits[0]))
        return Box(max(left, EDGE_PX), top, width, height, x_limits, y_limits), bottom

    def _frame(self, box: Box) -> list[str]:
        """Lines, ticks and their numbers, and the names of the axes."""
        right, lower = box.left + box.width, box.top + box.height
        lines = {
            "left": f"M{box.left:.1f} {box.top:.1f}V{lower:.1f}",
            "bottom": f"M{box.left:.1f} {lower:.1f}H{right:.1f}",
            "top": f"M{box.left:.1f} {box.top:.1f}H{right:.1f}",
            "right": f"M{right:.1f} {box.top:.1f}V{lower:.1f}",
        }
        d = "".join(line for name, line in lines.items() if name not in self.spines.hidden)
        parts = []
        ticks, texts = self._x.shown(box.width, X_TICK_PX)
        base = lower + self._tick_px + PAD_PX + ASCENT * FONT_PX
        for place, text in zip(box.left + box.x(ticks), texts, strict=True):
            d += f"M{place:.1f} {lower:.1f}v{self._tick_px:.1f}" if self._tick_px else ""
            parts.append(words(place, base, text, "middle"))
        ticks, texts = self._y.shown(box.height, Y_TICK_PX)
        edge = box.left - self._tick_px - PAD_PX
        for place, text in zip(box.top + box.y(ticks), texts, strict=True):
            d += f"M{box.left:.1f} {place:.1f}h{-self._tick_px:.1f}" if self._tick_px else ""
            parts.append(words(edge, place + 0.5 * (ASCENT - DESCENT) * FONT_PX, text, "end"))
        if self._x.name:
            lowest = base + (FONT_PX + PAD_PX if self._x.ticks != [] else 0.0)
            parts.append(words(box.left + 0.5 * box.width, lowest, self._x.name, "middle"))
        if self._y.name:
            place = f'transform="translate({ASCENT * FONT_PX:.1f} {box.top + 0.5 * box.height:.1f})rotate(-90)"'
            parts.append(f"<g {place}>{words(0.0, 0.0, self._y.name, 'middle')}</g>")
        return [f'<path d="{d}" stroke="{LINE_GREY}"/>' if d else "", *parts]


def _units(box: Box, x: Array, y: Array) -> tuple[Array, Array]:
    return UNITS_PER_PX * box.x(x), UNITS_PER_PX * box.y(y)
