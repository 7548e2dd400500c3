"""The legend of a plot: the names of its curves, with a piece of each."""

from __future__ import annotations

from dataclasses import dataclass

from .elements import ASCENT, DESCENT, FONT_PX, sample, text_px, words
from .scales import Box

HANDLE_PX = 20.0
"""Length of a line beside its name in the legend."""
LEGEND_LINE_PX = 17.0
LEGEND_GAP_PX = 18.0
"""Between the columns of a legend."""
PAD_PX = 4.0
"""Before a name, and between the axes and the legend."""


@dataclass(frozen=True)
class Handle:
    """One line of the legend."""

    text: str
    colour: str
    line_px: float
    dot_px: float


@dataclass(frozen=True)
class Legend:
    """The names of the curves."""

    handles: tuple[Handle, ...]
    loc: str
    anchor: tuple[float, float]
    columns: int
    dot_scale: float

    @property
    def handle_px(self) -> float:
        """The space for the line or dot before each name."""
        return HANDLE_PX if any(handle.line_px for handle in self.handles) else 0.5 * HANDLE_PX

    @property
    def column_px(self) -> float:
        """The distance from one column to the next."""
        widest = max((text_px(handle.text) for handle in self.handles), default=0.0)
        return self.handle_px + PAD_PX + widest + LEGEND_GAP_PX

    @property
    def size(self) -> tuple[float, float]:
        """Width and height."""
        columns = min(self.columns, len(self.handles))
        rows = -(-len(self.handles) // max(self.columns, 1))
        return columns * self.column_px - LEGEND_GAP_PX, rows * LEGEND_LINE_PX

    @property
    def is_beside(self) -> bool:
        """Whether it stands to the right of the data."""
        return "left" in self.loc and self.anchor[0] >= 1.0

    @property
    def is_above(self) -> bool:
        """Whether it stands above the data."""
        return "lower" in self.loc and self.anchor[1] >= 1.0

    def corner(self, box: Box) -> tuple[float, float]:
        """Its upper left corner in the picture."""
        width, height = self.size
        x, y = box.left + self.anchor[0] * box.width, box.top + (1.0 - self.anchor[1]) * box.height
        left = x - width if "right" in self.loc else x - 0.5 * width if self.loc.endswith("center") else x
        upper = y - height if "lower" in self.loc else y - 0.5 * height if self.loc.startswith("center") else y
        beside = 2.0 * PAD_PX if self.is_beside else 0.0
        return left + beside, upper - (PAD_PX if self.is_above else 0.0)

    def svg(self, box: Box) -> str:
        """All of it as elements."""
        left, upper = self.corner(box)
        parts = []
        for k, handle in enumerate(self.handles):
            row, column = divmod(k, self.columns)
            x, y = left + column * self.column_px, upper + (row + 0.5) * LEGEND_LINE_PX
            middle = x + 0.5 * self.handle_px
            if handle.line_px:
                parts.append(sample(f"M{x:.1f} {y:.1f}h{self.handle_px:.1f}", handle.colour, handle.line_px))
            if handle.dot_px:
                dot_px = self.dot_scale * handle.dot_px
                parts.append(sample(f"M{middle:.1f} {y:.1f}h0", handle.colour, dot_px))
            base = y + 0.5 * (ASCENT - DESCENT) * FONT_PX
            parts.append(words(x + self.handle_px + PAD_PX, base, handle.text, "start"))
        return "".join(parts)
