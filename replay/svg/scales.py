"""From values to places: the limits and ticks of one direction, and the rectangle that the data is drawn in."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .ticks import round_ticks, tick_texts

Array = NDArray[np.float64]

DEFAULT_MARGIN = 0.05
"""Free space beside the data, as a share of its extent."""
MIN_TICKS, MAX_TICKS = 4, 10


@dataclass
class Scale:
    """One direction of the axes: what was set, and how far the data reaches."""

    low: float | None = None
    high: float | None = None
    """At the left or lower end, and at the other; `low` may be the larger one."""
    margin: float = DEFAULT_MARGIN
    ticks: list[float] | None = None
    texts: list[str] | None = None
    name: str = ""
    reach: list[float] = field(default_factory=list)
    """The extremes of the data so far."""

    def include(self, values: ArrayLike) -> None:
        """Let the limits contain these values."""
        known = np.asarray(values, float)
        known = known[np.isfinite(known)]
        if known.size:
            self.reach = [min([*self.reach, float(known.min())]), max([*self.reach, float(known.max())])]

    def limits(self) -> tuple[float, float]:
        """The values at both ends."""
        low, high = self.reach or (0.0, 1.0)
        # As wide as the value is large: 1e-9 would be lost in its rounding.
        spare = self.margin * (high - low) if high > low else DEFAULT_MARGIN * max(abs(low), 1.0)
        low, high = low - spare, high + spare
        low, high = self.low if self.low is not None else low, self.high if self.high is not None else high
        return (low, high) if low != high else (low - 0.5, high + 0.5)

    def shown(self, length_px: float, tick_px: float) -> tuple[list[float], list[str]]:
        """The ticks on an axis of this length, and their texts."""
        low, high = sorted(self.limits())
        most = int(np.clip(length_px // tick_px, MIN_TICKS, MAX_TICKS))
        ticks = round_ticks(low, high, most) if self.ticks is None else self.ticks
        return ticks, self.texts if self.texts is not None else tick_texts(ticks)


@dataclass(frozen=True)
class Box:
    """The rectangle of the data within the picture, and the values at its edges."""

    left: float
    top: float
    width: float
    height: float
    x_limits: tuple[float, float]
    y_limits: tuple[float, float]

    def x(self, values: ArrayLike) -> Array:
        """Where values lie [px] from the box's left edge."""
        low, high = self.x_limits
        return np.asarray((np.asarray(values, float) - low) * (self.width / (high - low)))

    def y(self, values: ArrayLike) -> Array:
        """Where values lie [px] below the box's upper edge."""
        low, high = self.y_limits
        return np.asarray((high - np.asarray(values, float)) * (self.height / (high - low)))
