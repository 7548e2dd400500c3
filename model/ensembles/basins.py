"""Basins of attraction: the face that a die lands on, over a plane of initial conditions.

Two of the ten initial conditions of the paper span the plane, and the others are fixed (Kapitaniak et al., Chaos 22,
047504, 2012, Fig. 6: z0 against ω_η). Each pixel is one throw, from the conditions at its centre. Its coordinates are
computed exactly, as fractions of the decimals that bound the window, and rounded once. A zoom therefore shows the same
throws as a finer map of the whole, pixel for pixel, wherever the pixels coincide.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .landings import Landings, ThrowSetup, chunks_in_order
from .releases import CONDITIONS, states_of

Array = NDArray[np.float64]

FIG_6_CONDITIONS = {"z0": 0.3, "psi": 0.3, "theta": 1.2, "phi": 0.6}
"""The fixed conditions of the paper's Fig. 6; all others are zero. z0 is used if it is not an axis."""

MAX_PIXELS = 400_000_000
"""Largest number of pixels of one map: beyond it the arrays exceed the memory of an ordinary machine."""


@dataclass(frozen=True)
class Axis:
    """One of CONDITIONS, from `low` to `high`, divided into pixels."""

    name: str
    low: float
    high: float
    pixels: int

    def __post_init__(self) -> None:
        if self.name not in CONDITIONS:
            raise InputError(f"axis {self.name!r}: wanted one of {', '.join(CONDITIONS)}")
        if not (np.isfinite([self.low, self.high]).all() and self.low < self.high):
            raise InputError(f"{self.name} from {self.low} to {self.high}: wanted finite bounds, the lower one first")
        if self.pixels < 1:
            raise InputError(f"{self.name} in {self.pixels} pixels: wanted 1 or more")

    @property
    def centres(self) -> Array:
        """(pixels,) coordinates of the pixel centres, each the double nearest to the exact value."""
        # repr() gives the decimals that the user wrote, which a window and its zoom have in common.
        low, high = Fraction(repr(float(self.low))), Fraction(repr(float(self.high)))
        step = (high - low) / (2 * self.pixels)
        return np.array([float(low + (2 * k + 1) * step) for k in range(self.pixels)])


@dataclass(frozen=True)
class Window:
    """A rectangle in a plane of initial conditions."""

    x: Axis
    y: Axis
    fixed: Mapping[str, float] = field(default_factory=lambda: dict(FIG_6_CONDITIONS))
    """Values of the other CONDITIONS; those not named are zero."""

    def __post_init__(self) -> None:
        if self.x.name == self.y.name:
            raise InputError(f"axes {self.x.name} and {self.y.name}: wanted two different axes")
        for name, value in self.fixed.items():
            if name not in CONDITIONS:
                raise InputError(f"fixed condition {name!r}: wanted one of {', '.join(CONDITIONS)}")
            if not np.isfinite(value):
                raise InputError(f"{name} = {value}: wanted a finite number")
        if self.x.pixels * self.y.pixels > MAX_PIXELS:
            raise InputError(
                f"{self.x.pixels} × {self.y.pixels} pixels: wanted at most {MAX_PIXELS}; map it in parts, as zooms"
            )

    def states(self, points: Array) -> Array:
        """Releases (n, 13) at points (n, 2) of the plane, world axes."""
        numbers = np.zeros((len(points), len(CONDITIONS)))
        for name, value in self.fixed.items():
            numbers[:, CONDITIONS.index(name)] = value
        numbers[:, CONDITIONS.index(self.x.name)] = points[:, 0]
        numbers[:, CONDITIONS.index(self.y.name)] = points[:, 1]
        return states_of(numbers)


def map_rows(
    setup: ThrowSetup,
    window: Window,
    *,
    first: int = 0,
    after: int = 0,
    rows: int = 8,
    threads: int = 1,
    executor: Executor | None = None,
) -> Iterator[tuple[int, int, Landings]]:
    """Throw from every pixel, `rows` rows at a time; yields (i, j, landings of rows i to j - 1, x varying fastest).

    `first` is the row to begin with, and `after` the number of impacts at which the lowest face is recorded. `threads` and
    `executor` are those of `chunks_in_order`.
    """
    xs, ys = window.x.centres, window.y.centres
    yield from chunks_in_order(
        partial(landings_of_rows, setup, window, xs, ys, after), first, len(ys), rows, threads, executor
    )


def landings_of_rows(setup: ThrowSetup, window: Window, xs: Array, ys: Array, after: int, i: int, j: int) -> Landings:
    """The throws from all pixels of rows i to j - 1, with centres `xs` (columns,) and `ys` (rows,), x varying fastest."""
    points = np.stack(np.broadcast_arrays(xs, ys[i:j, None]), axis=-1).reshape(-1, 2)
    return setup.throw(window.states(points), after)


def final_configurations(
    setup: ThrowSetup, window: Window, points: Array, after: int | None = None
) -> NDArray[np.int64]:
    """The final configuration (n,) of throws from points (n, 2) of the plane, as one number each.

    It is the number of the face on which the die lands, or -1 minus the index of the ending if it lands on none. With
    `after`, it is the number of the lowest face at that impact instead.
    """
    landings = setup.throw(window.states(points), after or 0)
    if after is not None:
        return landings.lowest[:, after]
    return np.where(landings.face > 0, landings.face, -1 - landings.ending)
