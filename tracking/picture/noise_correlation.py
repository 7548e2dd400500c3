"""How correlated the errors of pixels beside edges are.

A codec, a filter in the camera and grain leave errors that neighbouring pixels share, across an edge and along it. Each pixel
line across an edge says by itself how far the edge lies from its projection. If errors of pixels were independent, these
shifts, in their standard errors, would have the variance 1 and no correlation. Instead they have a variance v, which errors
shared across the edge and stronger ones beside it increase, and covariances c_l with the lines l pixels on. A mean over many
lines then has the variance

    v + 2 Σ c_l

over that of independent pixels, and the information of the edges is divided by it: that of an estimate whose noise model is
wrong (Newey & West, Econometrica 55, 703, 1987). All are medians over the frames of a clip.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..placed_die import LINE_LAGS, LINE_PAIRS, LINE_PRODUCTS, LINE_SQUARES, LINES

Array = NDArray[np.float64]

LEAST_LINES = 30.0
"""Pairs of lines of a frame below which it says nothing of their correlation."""


def independent_share(statistics: Array) -> float:
    """The share, at most 1, of the pixels beside edges that would say as much if their errors were independent, from the
    statistics (n, STATISTICS) of the frames of a clip; 1 if they are too few to tell."""
    pairs, products = (statistics[:, first : first + LINE_LAGS] for first in (LINE_PAIRS, LINE_PRODUCTS))
    use = (pairs > LEAST_LINES).all(axis=1)
    if not use.any():
        return 1.0
    variance = np.median(statistics[use, LINE_SQUARES] / statistics[use, LINES])
    shared = np.median(products[use] / pairs[use], axis=0).sum()
    return float(1.0 / max(variance + 2.0 * shared, 1.0))
