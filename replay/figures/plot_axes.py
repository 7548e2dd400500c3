"""What the figures of one throw need of the axes that they draw on: matplotlib's axes and `SvgAxes` both have it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol, TypeVar


class PlotAxes(Protocol):
    """A part of matplotlib's axes, with matplotlib's meaning of every argument. Lengths are in points, sizes of text too."""

    @property
    def spines(self) -> Any:
        """The lines around the data: `spines[["top", "right"]].set_visible(False)`."""

    def plot(self, *args: Any, **style: Any) -> Any:
        """A curve, or dots."""

    def step(self, *args: Any, **style: Any) -> Any:
        """A curve of steps."""

    def bar(self, x: Sequence[str], height: Sequence[float], /, width: float = ..., *, color: str) -> Any:
        """A bar for each name."""

    def imshow(
        self,
        picture: Any,
        /,
        *,
        cmap: str = ...,
        vmin: float = ...,
        vmax: float = ...,
        interpolation: str = ...,
        extent: tuple[float, float, float, float] | None = ...,
    ) -> Any:
        """A picture of grey levels."""

    def text(
        self,
        x: float,
        y: float,
        text: str,
        /,
        *,
        ha: str = ...,
        va: str = ...,
        fontsize: float = ...,
        color: str = ...,
        bbox: Mapping[str, Any] | None = ...,
    ) -> Any:
        """Text at a place of the data."""

    def axhline(self, y: float, /, *, color: str, linewidth: float, zorder: float) -> Any:
        """A horizontal line across the axes."""

    def axvline(self, x: float, /, *, color: str, linewidth: float, linestyle: Any, zorder: float) -> Any:
        """A vertical line across the axes."""

    def axhspan(self, low: float, high: float, /, *, color: str, alpha: float, linewidth: float, zorder: float) -> Any:
        """A horizontal band across the axes."""

    def set_xlim(self, left: float | None = ..., right: float | None = ...) -> Any:
        """The limits, where the data's extent is not wanted."""

    def set_ylim(self, bottom: float | None = ..., top: float | None = ...) -> Any:
        """The limits, where the data's extent is not wanted."""

    def set_xlabel(self, xlabel: str, /) -> Any:
        """The quantity with its unit."""

    def set_ylabel(self, ylabel: str, /) -> Any:
        """The quantity with its unit."""

    def set_xticks(self, ticks: Any, labels: Sequence[str] | None = ...) -> Any:
        """The ticks, where round numbers are not wanted."""

    def set_yticks(self, ticks: Any, labels: Sequence[str] | None = ...) -> Any:
        """The ticks, where round numbers are not wanted."""

    def tick_params(self, *, length: float) -> Any:
        """How long the ticks are."""

    def set_aspect(self, aspect: Literal["auto", "equal"], /) -> Any:
        """Whether a unit is as long in both directions."""

    def margins(self, *, x: float) -> Any:
        """The space beside the data, as a share of its extent."""

    def legend(
        self,
        *,
        loc: Any,
        bbox_to_anchor: tuple[float, float],
        ncols: int = ...,
        frameon: bool = ...,
        markerscale: float = ...,
        handletextpad: float = ...,
    ) -> Any:
        """The names of the curves: its corner or side `loc` stands at the anchor, in shares of the axes."""


AnyAxes = TypeVar("AnyAxes", bound=PlotAxes)
"""The kind of axes that a figure was given, and returns."""
