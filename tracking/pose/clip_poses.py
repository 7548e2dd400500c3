"""Poses of all frames of a clip as arrays, and samples of frames for estimates of what a clip shares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import continuous_sign, matrix_from_quat, quat_from_matrix, quat_from_rotvec, rotation_between
from ...model.throw import turning_of
from ..footage import FrameSource
from ..picture import (
    PARAMETERS,
    STATISTICS,
    PoseRows,
    View,
    clear_shares,
    costs_with_edge_noise,
    shares_in_view,
    supports,
)
from ..throw import ENOUGH_FRAMES
from ..track import LOST, TRACKED, Track
from .refine import Pose, bias_jacobians, covariances

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Rows = NDArray[np.int64]
Picture = Callable[[int], NDArray[np.generic]]
"""Reads the picture of a frame by its row in the clip."""


@dataclass(eq=False)
class ClipPoses:
    """Poses of single frames, one row per frame of the clip; rows without a pose hold NaN."""

    known: Mask
    """(n,) whether a row has a pose."""
    position_m: Array
    """(n, 3)"""
    rotation: Array
    """(n, 3, 3) body to world."""
    motion: Array
    """(n, 6) velocity [m/s] and angular velocity [rad/s] that the motion blur was computed with."""
    H: Array
    """(n, 9, 9) normal equations of pose, contour error, blur and response, see `NormalEquations`."""
    statistics: Array
    """(n, STATISTICS) counts of the kernels, see `ROBUST_COST` and those beside it."""
    cost: Array
    """(n,) pose cost, see `pose_costs`."""
    bias_jacobian: Array
    """(n, 6, 2) change of each pose by contour error and response, see `bias_jacobians`; NaN where it follows from H."""
    begins: Mask
    """(n,) rows on which tracking began another flight."""
    frame_stride: int = 1
    """Rows that are multiples of this one represent all: where little moves, those between may have been left out."""

    _COLUMNS: ClassVar = (
        "known", "position_m", "rotation", "motion", "H", "statistics", "cost", "bias_jacobian", "begins",
    )  # fmt: skip

    @staticmethod
    def empty(n: int) -> ClipPoses:
        """No poses on n frames."""
        return ClipPoses(
            np.zeros(n, bool), np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan), np.zeros((n, 6)),
            np.zeros((n, PARAMETERS, PARAMETERS)), np.zeros((n, STATISTICS)), np.full(n, np.inf), np.full((n, 6, 2), np.nan),
            np.zeros(n, bool),
        )  # fmt: skip

    @property
    def evenly_spaced(self) -> Mask:
        """(n,) known rows that are as far apart as anywhere in the clip."""
        return np.asarray(self.known & (np.arange(len(self.known)) % self.frame_stride == 0))

    @property
    def frames(self) -> int:
        """Number of frames with a pose, including those that were left out between two others."""
        return int(self.interpolated().known.sum())

    @property
    def clear_share(self) -> Array:
        """(n,) share of the contour that shows a clear step."""
        return clear_shares(self.statistics)

    @property
    def support(self) -> Array:
        """(n,) length of contour that shows a clear step, over that which does in the mean if the pose is right."""
        return supports(self.statistics)

    @property
    def cost_with_edge_noise(self) -> Array:
        """(n,) see `costs_with_edge_noise`."""
        return costs_with_edge_noise(self.cost, self.statistics)

    def put(self, k: int, pose: Pose, motion: Array, begins: bool = False) -> None:
        """Write the pose of one frame."""
        self.known[k], self.begins[k] = True, begins
        self.position_m[k], self.rotation[k], self.motion[k] = pose.position_m, pose.rotation, motion
        self.H[k], self.statistics[k], self.cost[k] = pose.H, pose.statistics, pose.cost

    def put_rows(self, rows: Rows, found: PoseRows) -> None:
        """Write the poses of some frames, as the kernels return them."""
        self.known[rows], self.begins[rows] = True, False
        self.position_m[rows], self.rotation[rows], self.motion[rows] = found.position, found.rotation, found.motion
        self.H[rows], self.statistics[rows], self.cost[rows] = found.H, found.statistics, found.cost

    def copy(self) -> ClipPoses:
        """The same in arrays of its own."""
        return replace(self, **{name: getattr(self, name).copy() for name in self._COLUMNS})

    def interpolated(self) -> ClipPoses:
        """With poses interpolated on rows that were left out between two known ones; their pictures were not used."""
        out = self.copy()
        known = np.flatnonzero(self.known)
        right = np.searchsorted(known, np.arange(len(self.known)), side="right")
        rows = np.flatnonzero((right > 0) & (right < len(known)) & ~self.known)
        before, after = known[right[rows] - 1], known[right[rows]]
        near = after - before <= longest_stride(len(self.known))
        rows, before, after = rows[near], before[near], after[near]
        share = ((rows - before) / (after - before))[:, None]
        turn = rotation_between(quat_from_matrix(self.rotation[before]), quat_from_matrix(self.rotation[after]))
        out.position_m[rows] = self.position_m[before] + share * (self.position_m[after] - self.position_m[before])
        out.rotation[rows] = matrix_from_quat(quat_from_rotvec(share * turn)) @ self.rotation[before]
        out.motion[rows], out.known[rows] = self.motion[before], True
        return out

    def sample(self, picture: Picture, use: Mask, count: int) -> SampledFrames:
        """At most `count` of the rows in `use`, evenly spread, with their pictures."""
        rows = np.flatnonzero(use)
        return SampledFrames.at(rows, picture, self.position_m[rows], self.rotation[rows], self.motion[rows], count)

    def take(self, rows: Rows, other: ClipPoses, others: Rows | None = None) -> None:
        """Copy some rows from the same rows of another clip's poses, or from its rows `others`."""
        for name in self._COLUMNS:
            getattr(self, name)[rows] = getattr(other, name)[rows if others is None else others]


@dataclass(frozen=True, eq=False)
class SampledFrames:
    """Some frames with poses, for an estimate of what all frames share."""

    pictures: tuple[NDArray[np.float32], ...]
    """(cameras, height, width) each."""
    position_m: Array
    """(n, 3)"""
    rotation: Array
    """(n, 3, 3)"""
    motion: Array
    """(n, 6) velocity [m/s] and angular velocity [rad/s], for the blur."""

    @staticmethod
    def at(
        rows: Rows, picture: Picture, position_m: Array, rotation: Array, motion: Array, count: int
    ) -> SampledFrames:
        """At most `count` of some rows (k,), evenly spread; the poses (k, 3), (k, 3, 3), (k, 6) are those of the
        rows."""
        chosen = _spread(len(rows), count)
        pictures = tuple(np.ascontiguousarray(picture(int(rows[k])), np.float32) for k in chosen)
        return SampledFrames(pictures, position_m[chosen], rotation[chosen], motion[chosen])

    def sample(self, count: int) -> SampledFrames:
        """At most `count` of them, evenly spread."""
        chosen = _spread(len(self), count)
        pictures = tuple(self.pictures[k] for k in chosen)
        return SampledFrames(pictures, self.position_m[chosen], self.rotation[chosen], self.motion[chosen])

    def __len__(self) -> int:
        return len(self.pictures)


def _spread(n: int, count: int) -> Rows:
    """At most `count` evenly spread indices below n."""
    return np.unique(np.linspace(0, n - 1, min(count, n)).astype(int))


def longest_stride(frames: int) -> int:
    """The largest stride that leaves enough frames of a clip of so many."""
    return power_of_two(frames / ENOUGH_FRAMES)


def power_of_two(most: float) -> int:
    """The largest power of two that is no larger; 1 at the least."""
    return 1 << max(int(most).bit_length() - 1, 0)


def as_track(view: View, source: FrameSource, poses: ClipPoses, use: Mask | None = None) -> Track:
    """A track of the frames with a pose, or of those among them in `use`; the others are lost, and so are poses whose
    pixels leave a direction open. Its times are `exposure_times_s`."""
    n = len(source)
    known = poses.known if use is None else poses.known & use
    covariance = np.full((n, 6, 6), np.nan)
    covariance[known] = covariances(poses.H[known][:, :6, :6])
    known = known & np.isfinite(covariance[:, 0, 0])
    position = np.where(known[:, None], poses.position_m, np.nan)
    quaternion = np.full((n, 4), np.nan)
    quaternion[known] = quat_from_matrix(poses.rotation[known])
    status = np.where(known, TRACKED, LOST).astype("<U7")
    frames = source.first_frame + np.arange(n)
    by_pixels = bias_jacobians(view, poses.H[known], poses.position_m[known])
    kept = poses.bias_jacobian[known][:, :, : by_pixels.shape[2]]
    jacobian = np.full((n, 6, by_pixels.shape[2]), np.nan)
    jacobian[known] = np.where(np.isfinite(kept), kept, by_pixels)
    return Track(
        frames, exposure_times_s(view, source, poses), position, continuous_sign(quaternion), covariance, status, jacobian,
        response_sigma=view.response_sigma, gravity_m_s2=view.gravity_m_s2, turning=turning_of(view.die),
    )  # fmt: skip


def exposure_times_s(view: View, source: FrameSource, poses: ClipPoses) -> Array:
    """(n,) the times of the poses: those of the frames, and with a rolling shutter the instants at which the row of the
    die's centre is exposed; frames without a pose have that of the frame."""
    if view.readout_s == 0.0:
        return source.times_s
    return np.asarray(source.times_s + view.exposure_delay_s(poses.position_m))


def wholly_in_view(view: View, poses: ClipPoses) -> Mask:
    """(n,) frames with a pose whose die lies entirely inside a picture."""
    rows, whole = np.flatnonzero(poses.known), np.zeros(len(poses.known), bool)
    whole[rows] = shares_in_view(view, poses.position_m[rows], poses.rotation[rows]) == 1.0
    return whole
