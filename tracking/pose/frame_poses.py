"""What is known of each frame while a die is followed: a pose, what the pixels say of it, and how well they bear it out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import continuous_sign, matrix_from_quat, quat_from_matrix, quat_from_rotvec, rotation_between
from ..footage import FrameSource
from ..picture import View, shares_in_view
from ..throw import ENOUGH_FRAMES
from ..track import LOST, TRACKED, Track
from .refine import Pose, contour_bias_jacobians, covariances, misfits

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Picture = Callable[[int], NDArray[np.generic]]


@dataclass(eq=False)
class ClipPoses:
    """Poses of single frames as arrays, one row a frame of the clip; rows that are not known hold NaN."""

    known: NDArray[np.bool_]
    position_m: Array
    rotation: Array
    """(n, 3, 3) body to world."""
    motion: Array
    """(n, 6) velocity [m/s] and angular velocity [rad/s] that were assumed for the blur."""
    H: Array
    """(n, 8, 8) normal equations: see `edges`."""
    stats: Array
    cost: Array
    """How badly each picture is explained."""
    lean: Array
    """(n, 6) what a pixel of contour error does to each pose: see `Track`."""
    every: int = 1
    """Rows that are multiples of this one stand for all: where little moves on the way those between may have been left out."""

    _COLUMNS: ClassVar = ("known", "position_m", "rotation", "motion", "H", "stats", "cost", "lean")

    @staticmethod
    def empty(n: int) -> ClipPoses:
        """Nothing seen on n frames."""
        return ClipPoses(
            np.zeros(n, bool), np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan), np.zeros((n, 6)),
            np.zeros((n, 8, 8)), np.zeros((n, 8)), np.full(n, np.inf), np.full((n, 6), np.nan),
        )  # fmt: skip

    @property
    def even(self) -> NDArray[np.bool_]:
        """(n,) known rows as far apart as anywhere."""
        return np.asarray(self.known & (np.arange(len(self.known)) % self.every == 0))

    @property
    def frames(self) -> int:
        """How many have a pose, those that were left out between two others included."""
        return int(self.filled().known.sum())

    @property
    def support(self) -> Array:
        """(n,) share of the contour that shows a clear step."""
        return np.asarray(self.stats[:, 4] / np.maximum(self.stats[:, 3], 1e-9))

    @property
    def misfit(self) -> Array:
        """(n,) how badly each picture is explained, as a whole and at the edges."""
        return misfits(self.cost, self.stats)

    def put(self, k: int, pose: Pose, motion: Array) -> None:
        """Write one frame."""
        self.known[k], self.position_m[k], self.rotation[k], self.motion[k] = (
            True,
            pose.position_m,
            pose.rotation,
            motion,
        )
        self.H[k], self.stats[k], self.cost[k] = pose.equations, pose.stats, pose.cost

    def copy(self) -> ClipPoses:
        """The same in arrays of its own."""
        return replace(self, **{name: getattr(self, name).copy() for name in self._COLUMNS})

    def filled(self) -> ClipPoses:
        """With starts on rows that were left out between two known ones, on a straight way from one to the other. What the
        pictures say of those nobody has seen."""
        out = self.copy()
        known = np.flatnonzero(self.known)
        right = np.searchsorted(known, np.arange(len(self.known)), side="right")
        rows = np.flatnonzero((right > 0) & (right < len(known)) & ~self.known)
        before, after = known[right[rows] - 1], known[right[rows]]
        near = after - before <= longest_leap(len(self.known))
        rows, before, after = rows[near], before[near], after[near]
        share = ((rows - before) / (after - before))[:, None]
        turn = rotation_between(quat_from_matrix(self.rotation[before]), quat_from_matrix(self.rotation[after]))
        out.position_m[rows] = self.position_m[before] + share * (self.position_m[after] - self.position_m[before])
        out.rotation[rows] = matrix_from_quat(quat_from_rotvec(share * turn)) @ self.rotation[before]
        out.motion[rows], out.known[rows] = self.motion[before], True
        return out

    def looks(self, picture: Picture, use: Mask, count: int) -> SampledFrames:
        """So many of the rows in `use` at the most, spread evenly, with their pictures."""
        rows = np.flatnonzero(use)
        return SampledFrames.at(rows, picture, self.position_m[rows], self.rotation[rows], self.motion[rows], count)

    def take(self, rows: NDArray[np.int64], other: ClipPoses, others: NDArray[np.int64] | None = None) -> None:
        """Take some rows over, from the same rows of another or from `others`."""
        for name in self._COLUMNS:
            getattr(self, name)[rows] = getattr(other, name)[rows if others is None else others]


@dataclass(frozen=True, eq=False)
class SampledFrames:
    """Some frames with poses: what the pictures as a whole are asked at."""

    pictures: tuple[NDArray[np.float32], ...]
    """(cameras, height, width) each."""
    position_m: Array
    """(n, 3)"""
    rotation: Array
    """(n, 3, 3)"""
    motion: Array
    """(n, 6) velocity and spin, for the blur."""

    @staticmethod
    def at(
        rows: NDArray[np.int64],
        picture: Picture,
        position_m: Array,
        rotation: Array,
        motion: Array,
        count: int,
    ) -> SampledFrames:
        """So many of these rows at the most, spread evenly; the poses (k, 3), (k, 3, 3), (k, 6) are those of the rows."""
        chosen = np.unique(np.linspace(0, len(rows) - 1, min(count, len(rows))).astype(int))
        pictures = tuple(np.ascontiguousarray(picture(int(rows[k])), np.float32) for k in chosen)
        return SampledFrames(pictures, position_m[chosen], rotation[chosen], motion[chosen])

    def some(self, count: int) -> SampledFrames:
        """So many of them at the most, spread evenly."""
        chosen = np.unique(np.linspace(0, len(self) - 1, min(count, len(self))).astype(int))
        pictures = tuple(self.pictures[k] for k in chosen)
        return SampledFrames(pictures, self.position_m[chosen], self.rotation[chosen], self.motion[chosen])

    def __len__(self) -> int:
        return len(self.pictures)


def longest_leap(frames: int) -> int:
    """From how many frames of a clip of so many one is plenty."""
    return power_of_two(frames / ENOUGH_FRAMES)


def power_of_two(most: float) -> int:
    """The largest one that is no larger; 1 at the least."""
    return 1 << max(int(most).bit_length() - 1, 0)


def as_track(view: View, source: FrameSource, seen: ClipPoses, use: Mask | None = None) -> Track:
    """A track of the frames that have a pose, of those in `use` alone where that is given; the others are lost."""
    n = len(source)
    known = seen.known if use is None else seen.known & use
    covariance = np.full((n, 6, 6), np.nan)
    covariance[known] = covariances(seen.H[known][:, :6, :6])
    known = known & np.isfinite(covariance[:, 0, 0])
    position = np.where(known[:, None], seen.position_m, np.nan)
    quaternion = np.full((n, 4), np.nan)
    quaternion[known] = quat_from_matrix(seen.rotation[known])
    status = np.where(known, TRACKED, LOST).astype("<U7")
    frames = source.first_frame + np.arange(n)
    lean = np.full((n, 6), np.nan)
    lean[known] = contour_bias_jacobians(seen.H[known], view.settings)
    lean = np.where(np.isfinite(seen.lean), seen.lean, lean)
    return Track(frames, source.times_s, position, continuous_sign(quaternion), covariance, status, lean)


def shown_whole(view: View, seen: ClipPoses) -> Mask:
    """(n,) frames with a pose whose die lies wholly in view."""
    rows, whole = np.flatnonzero(seen.known), np.zeros(len(seen.known), bool)
    whole[rows] = shares_in_view(view, seen.position_m[rows], seen.rotation[rows]) == 1.0
    return whole
