"""The background of a clip, from frames with known poses: each pixel is measured where the die does not cover it.

Without a picture of the empty scene the background is first estimated from all frames together, and holds what the die shows
where it stays for long: at its highest point, or where it comes to rest. Once the die is tracked, the frames in which it covers a
pixel are known."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.rotations import cross_matrix
from ..footage import FrameSource
from ..picture import Image, Mask, View, differs_from_background, outline_mask
from ..pose import ClipPoses

Array = NDArray[np.float64]

EMPTY_SCENE_FRAMES = 60
"""Most frames that are used."""
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


def empty_scene(view: View, source: FrameSource, poses: ClipPoses) -> EmptyScene:
    """The backgrounds of a view with the pixels that the die covers on some frames measured on the others."""
    known = np.flatnonzero(poses.known)
    rows = known[np.unique(np.linspace(0, len(known) - 1, min(EMPTY_SCENE_FRAMES, len(known))).astype(int))]
    pictures = np.stack([source.frame(int(k)) for k in rows])
    backgrounds, shares = view.backgrounds.copy(), []
    for c, camera in enumerate(view.cameras):
        inside = backgrounds[c, : camera.height_px, : camera.width_px]
        before = inside.copy()
        covered = np.stack([_covered(view, c, poses, int(k)) for k in rows])
        behind = covered.any(0)
        frames = pictures[:, c, : camera.height_px, : camera.width_px]
        inside[behind] = _median_where(~covered[:, behind], frames[:, behind], before[behind])
        changed = differs_from_background(inside, before, view.noise_grey, view.level_grey)
        shares.append(float(changed[behind].mean()) if behind.any() else 0.0)
    return EmptyScene(backgrounds, max(shares))


def _covered(view: View, c: int, poses: ClipPoses, k: int) -> Mask:
    """(height, width) the pixels of camera `c` that the die, moving during the exposure, or its reflection covers on a frame."""
    camera = view.cameras[c]
    arms = view.die.solid.vertices @ poses.rotation[k].T
    velocity_m_s, omega_rad_s = np.split(poses.motion[k], 2)
    path = 0.5 * view.exposure_s * (velocity_m_s + arms @ cross_matrix(omega_rad_s).T)
    corners_m = np.concatenate([poses.position_m[k] + arms + path, poses.position_m[k] + arms - path])
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
