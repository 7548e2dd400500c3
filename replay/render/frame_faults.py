"""Faults of the order of frames: which picture of the camera each frame of a file shows.

In a file without time stamps nobody sees at once that a frame is missing, is stored twice, or shows an older picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError

FROZEN_FRAMES = 3
"""Length of a freeze: that many frames repeat the picture before them."""
FAULTLESS_FRAMES = 2
"""Frames at the beginning of a film without a fault."""


@dataclass(frozen=True)
class FrameFaults:
    """How many frames of a film have a fault, as shares of its pictures; at least one if the share is above 0."""

    missing: float = 0.0
    """Pictures that the file does not hold; those after them move up."""
    doubled: float = 0.0
    """Pictures that it holds twice; those after them move down."""
    frozen: float = 0.0
    """Pictures after which the film stands still for FROZEN_FRAMES frames, which are lost."""

    def __post_init__(self) -> None:
        for name in ("missing", "doubled", "frozen"):
            if not 0 <= getattr(self, name) <= 0.5:
                raise InputError(f"{name} = {getattr(self, name)}: wanted a share of the frames, 0 to 0.5")

    @property
    def any(self) -> bool:
        """Whether there are any."""
        return self.missing > 0 or self.doubled > 0 or self.frozen > 0


def shown_pictures(faults: FrameFaults, pictures: int, seed: int) -> NDArray[np.int64]:
    """(frames,) number of the camera's picture that each frame of the file shows."""
    rng = np.random.default_rng([seed, 4])
    shown = np.arange(pictures)
    for begin in _chosen(rng, faults.frozen, pictures - 1):
        shown[begin + 1 : begin + 1 + FROZEN_FRAMES] = shown[begin]
    copies = np.ones(pictures, np.int64)
    copies[_chosen(rng, faults.doubled, pictures)] = 2
    copies[_chosen(rng, faults.missing, pictures)] = 0
    return np.repeat(shown, copies)


def _chosen(rng: np.random.Generator, share: float, pictures: int) -> NDArray[np.int64]:
    """Pictures that have a fault."""
    free = np.arange(FAULTLESS_FRAMES, max(pictures, FAULTLESS_FRAMES))
    count = min(max(1, round(share * pictures)), len(free)) if share > 0 else 0
    return np.asarray(np.sort(rng.choice(free, count, replace=False)), np.int64)
