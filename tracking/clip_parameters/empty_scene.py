"""The background of a clip, from frames with known poses: each pixel is measured where the die does not cover it.

Without a picture of the empty scene the background is first estimated from all frames together, and holds what the die shows
where it stays for long: at its highest point, or where it comes to rest. Once the die is tracked, the frames in which it covers a
pixel are known. So are those before its first pose, and after the last, over which its flight leads on: there a die that comes
into view and then stays on the table has not yet covered it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.rotations import cross_matrix, quat_from_matrix
from ...model.throw import State
from ..footage import FrameSource
from ..picture import Image, Mask, View, differs_from_background, flight_from, outline_mask
from ..pose import ClipPoses

Array = NDArray[np.float64]

EMPTY_SCENE_FRAMES = 60
"""Most frames with poses that are used, and most beyond them."""
LEAST_UNCOVERED = 5
"""Least number of frames that show a pixel beside the die; others keep the grey level that they had."""
MARGIN_PX = 4
"""Margin about the outline of the die: its blur, and errors of its pose."""


@dataclass(frozen=True, eq=False)
class EmptyScene:
    """The scene without the die, as several cameras see it."""

    backgrounds: NDArray[np.float32]
    """(cameras, height, width), as in `View`."""
    changed_share: float
    """Share of the pixels behind the die that differ from those of the view, of the camera where it is largest."""


def empty_scene(view: View, source: FrameSource, poses: ClipPoses, unused: Mask) -> EmptyScene:
    """The backgrounds of a view with the pixels that the die covers on some frames measured on the others, but for those that are
    `unused` (n,)."""
    rows = _spread(np.flatnonzero(poses.known))
    beyond = [one for step in (-1, 1) for one in _flight_beyond(view, source, poses, step) if not unused[one[0]]]
    beyond = [beyond[k] for k in _spread(np.arange(len(beyond)))]
    pictures = np.stack([source.frame(int(k)) for k in (*rows, *(k for k, _ in beyond))])
    backgrounds, shares = view.backgrounds.copy(), []
    for c, camera in enumerate(view.cameras):
        inside = backgrounds[c, : camera.height_px, : camera.width_px]
        before = inside.copy()
        covered = np.stack([_covered(view, c, poses, int(k)) for k in rows])
        behind = covered.any(0)
        covered = np.concatenate([covered, *(_covered_from(view, c, corners_m)[None] for _, corners_m in beyond)])
        frames = pictures[:, c, : camera.height_px, : camera.width_px]
        inside[behind] = _median_where(~covered[:, behind], frames[:, behind], before[behind])
        changed = differs_from_background(inside, before, view.noise_grey, view.level_grey)
        shares.append(float(changed[behind].mean()) if behind.any() else 0.0)
    return EmptyScene(backgrounds, max(shares))


def _spread(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """At most EMPTY_SCENE_FRAMES of some rows, evenly spread."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(EMPTY_SCENE_FRAMES, len(rows))).astype(int))]


def _flight_beyond(view: View, source: FrameSource, poses: ClipPoses, step: int) -> list[tuple[int, Array]]:
    """The rows before the first pose (`step` -1) or after the last (1) over which the die flies on, too high to touch the table,
    with the corners (8, 3) [m] of a box about it."""
    known = np.flatnonzero(poses.known)
    end = int(known[0] if step < 0 else known[-1])
    rows = np.arange(end + step, -1 if step < 0 else len(poses.known), step)
    velocity_m_s, omega_rad_s = np.split(poses.motion[end], 2)
    quaternion = quat_from_matrix(poses.rotation[end])
    state = State(float(source.times_s[end]), poses.position_m[end], quaternion, velocity_m_s, omega_rad_s)
    centres_m, _ = flight_from(view, state).poses(source.times_s[rows])
    low = np.flatnonzero(centres_m[:, 2] < view.reach_m)
    flying = slice(0, int(low[0]) if len(low) else len(rows))
    box_m = view.reach_m * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return [(int(row), centre_m + box_m) for row, centre_m in zip(rows[flying], centres_m[flying], strict=True)]


def _covered(view: View, c: int, poses: ClipPoses, k: int) -> Mask:
    """(height, width) the pixels of camera `c` that the die, moving during the exposure, or its reflection covers on a frame."""
    arms = view.die.solid.vertices @ poses.rotation[k].T
    velocity_m_s, omega_rad_s = np.split(poses.motion[k], 2)
    path = 0.5 * view.exposure_s * (velocity_m_s + arms @ cross_matrix(omega_rad_s).T)
    return _covered_from(
        view, c, np.concatenate([poses.position_m[k] + arms + path, poses.position_m[k] + arms - path])
    )


def _covered_from(view: View, c: int, corners_m: Array) -> Mask:
    """(height, width) the pixels of camera `c` that a body with corners (n, 3) [m], or its reflection, covers."""
    camera = view.cameras[c]
    out = outline_mask(camera, corners_m)
    if view.mirror:
        out |= outline_mask(camera, corners_m * [1.0, 1.0, -1.0])
    reach = 2 * (MARGIN_PX + round(view.blur_px)) + 1
    return np.asarray(
        cv2.dilate(out.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))) > 0
    )


def _median_where(use: Mask, samples: NDArray[np.generic], otherwise: Image) -> Image:
    """(m,) medians of the samples (n, m) in use; `otherwise` (m,) where these are fewer than LEAST_UNCOVERED."""
    count = use.sum(0)
    order = np.sort(np.where(use, samples, np.float32(np.inf)), axis=0)
    low, high = (np.take_along_axis(order, k[None], axis=0)[0] for k in (np.maximum(count - 1, 0) // 2, count // 2))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(count >= LEAST_UNCOVERED, 0.5 * (low + high), otherwise), np.float32)
