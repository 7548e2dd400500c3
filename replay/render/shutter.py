"""The shutter: at which instants a frame sees the dice, and for which share of its exposure each row does.

**Global shutter.** All rows see the same instants, spread evenly over the exposure, so many that no corner moves more than
`MAX_STEP_PX` between two of them. This gives the true motion blur, also across an impact.

**Rolling shutter.** Rows are exposed one after another: row r of `rows` at mid-exposure

    t_r = t + (r / (rows - 1) - 1/2) readout

The whole span of readout and exposure is cut into cells of one n-th of an exposure, each with the dice at its middle. A row takes
from every cell the share of its own exposure that lies in it. As an exposure is a whole number of cells long, the mean instant
of a row is exactly its own t_r: with one cell per exposure the shares interpolate linearly between two instants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError

Array = NDArray[np.float64]

MAX_STEP_PX = 0.4
"""Largest step of a corner between two instants of an exposure: below the lens blur, so that the steps are invisible."""
MAX_INSTANTS = 160
"""Instants of an exposure. At 0.4 px a step they cover 64 px, more than half a die: nothing sharp is left to show steps."""
MAX_CELLS = 2048
"""Cells of readout and exposure together. Beyond it the cells become wider than the exposure: in a readout of 10 ms, at 5 µs."""


@dataclass(frozen=True)
class Shutter:
    """How the rows of a frame are exposed."""

    exposure_s: float
    readout_s: float = 0.0
    """From the first row's mid-exposure to the last row's; 0 for a global shutter."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.exposure_s) and self.exposure_s > 0):
            raise InputError(f"exposure_s = {self.exposure_s}: wanted a finite number above 0")
        if not (np.isfinite(self.readout_s) and self.readout_s >= 0):
            raise InputError(
                f"readout_s = {self.readout_s}: wanted 0 for a global shutter, or the time from row to row"
            )

    @property
    def span_s(self) -> float:
        """From the first light on any row to the last."""
        return self.exposure_s + self.readout_s


@dataclass(frozen=True, eq=False)
class Instants:
    """The instants of one frame."""

    times_s: Array
    """(m,)."""
    row_shares: Array | None
    """(rows, m) share of each row's exposure, whose sum over the instants is 1; None if all rows see all of them equally."""


def instants_of(time_s: float, shutter: Shutter, rows: int, moved_px: float, fewest: int = 1) -> Instants:
    """The instants of a frame at `time_s`, if corners move by `moved_px` during `shutter.span_s`.

    `fewest` is the least number of instants of a row, for effects other than motion that are averaged over them.
    """
    least_step_s = MAX_STEP_PX / moved_px * shutter.span_s if moved_px > 0 else np.inf
    if shutter.readout_s == 0:
        count = _steps(shutter.exposure_s, least_step_s, fewest)
        return Instants(time_s + shutter.exposure_s * ((np.arange(count) + 0.5) / count - 0.5), None)
    # An exposure that shows no motion may as well be as long as one invisible step.
    exposure_s = max(shutter.exposure_s, min(least_step_s, shutter.span_s), shutter.span_s / MAX_CELLS)
    cell_s = exposure_s / _steps(exposure_s, least_step_s, fewest)
    cell_s = max(cell_s, shutter.span_s / MAX_CELLS)
    count = int(np.ceil((shutter.readout_s + exposure_s) / cell_s - 1e-9))
    begin_s = -(shutter.readout_s + exposure_s) / 2
    low = begin_s + cell_s * np.arange(count)
    middle = row_times(shutter.readout_s, rows)[:, None]
    overlap = np.minimum(low + cell_s, middle + exposure_s / 2) - np.maximum(low, middle - exposure_s / 2)
    shares = np.maximum(overlap, 0.0)
    return Instants(np.asarray(time_s + low + cell_s / 2), np.asarray(shares / shares.sum(1, keepdims=True)))


def row_times(readout_s: float, rows: int) -> Array:
    """(rows,) [s] mid-exposures of the rows after that of the frame, which is the middle row's."""
    return np.asarray(readout_s * (np.arange(rows) / max(rows - 1, 1) - 0.5))


def _steps(exposure_s: float, least_step_s: float, fewest: int) -> int:
    """Instants of one exposure."""
    return int(np.clip(np.ceil(exposure_s / least_step_s - 1e-9), fewest, max(MAX_INSTANTS, fewest)))
