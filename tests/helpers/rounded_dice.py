"""Pictures of a cube with rounded corners by ray marching, with 16 rays per pixel.

A rounded cube is all points within the radius r of a smaller cube of half edge h - r, so a point p lies
|max(|p| - (h - r), 0)| - r from its surface, and a ray that goes on by that much never passes through it (Hart, The Visual
Computer 12, 527, 1996). The surface is of one paint, dull or glossy (Blinn, Computer Graphics 11, 192, 1977); its shade follows
from the exact normal.
"""

from __future__ import annotations

import cv2
import numpy as np
from footage_of_throws import FINER, LIGHT, Image, Studio
from numpy.typing import NDArray

from diethrow.model.die.die import Die
from diethrow.model.throw.motion import State

Array = NDArray[np.float64]

GLOSS_POWER = 80.0
"""Exponent of the cosine between the normal and the bisector of light and view: a highlight ten degrees wide."""
MARCHES = 300
"""Steps along a ray: those that graze a face are the slowest, and with 40 of them missed the die."""
NEAR_M = 1e-7


def photograph_rounded(
    room: Studio, cube: Die, state: State, rng: np.random.Generator | None = None, *, gloss_grey: float = 0.0,
    paint: Array | None = None,
) -> Image:  # fmt: skip
    """One frame (height, width) of a rounded cube that does not move; not rounded to grey levels. A highlight is brighter by
    `gloss_grey`; `paint` (6,) is the reflectance of the faces, and of their bevels half-way."""
    camera, (height, width) = room.camera, room.table.shape
    corners = camera.project(cube.solid.vertices @ state.rotation.T + state.position_m)
    low = np.maximum(np.floor(corners.min(0) - 6), 0).astype(int)
    high = np.minimum(np.ceil(corners.max(0) + 7), [width, height]).astype(int)
    x, y = ((np.arange(a * FINER, b * FINER) + 0.5) / FINER - 0.5 for a, b in zip(low, high, strict=True))
    pixels = np.stack(np.meshgrid(x, y), -1).reshape(-1, 1, 2)
    flat = cv2.undistortPoints(pixels, camera.matrix, camera.distortion)[:, 0]
    ray = np.column_stack([flat, np.ones(len(flat))]) @ camera.rotation @ state.rotation
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    eye = (camera.centre_m - state.position_m) @ state.rotation
    normal, hit = _surface(eye, ray, cube.solid.inradius, cube.corner_radius_m)
    light_from = LIGHT @ state.rotation
    shade = 115.0 + 90.0 * np.maximum(normal @ light_from, 0.0)
    if paint is not None:
        along = np.abs(normal).argmax(1)
        outward = np.take_along_axis(normal, along[:, None], 1) * np.eye(3)[along]
        shade *= paint[np.argmax(outward @ cube.solid.normals.T, axis=1)]
    if gloss_grey:
        middle = light_from - ray
        middle /= np.linalg.norm(middle, axis=1)[:, None]
        shade += gloss_grey * np.maximum((normal * middle).sum(1), 0.0) ** GLOSS_POWER
    size = (len(y), len(x))
    light, cover = (_seen(values.reshape(size), room.blur_px) for values in (shade * hit, hit.astype(float)))
    picture = room.table.astype(float)
    rows, columns = slice(low[1], high[1]), slice(low[0], high[0])
    picture[rows, columns] = light + picture[rows, columns] * (1.0 - cover)
    if rng is not None and room.noise_grey:
        picture += rng.normal(scale=room.noise_grey, size=picture.shape)
    return np.asarray(picture, np.float32)


def _surface(eye: Array, ray: Array, half_m: float, radius_m: float) -> tuple[Array, NDArray[np.bool_]]:
    """Outward normals (n, 3) where rays (n, 3) from a point meet the surface, body axes, and which rays do."""
    inner = half_m - radius_m
    reach = np.sqrt(3.0) * half_m
    gone = np.full(len(ray), np.linalg.norm(eye) - reach)
    under_way = np.arange(len(ray))
    for _ in range(MARCHES):
        step = _distance(eye + gone[under_way, None] * ray[under_way], inner, radius_m)
        gone[under_way] += step
        under_way = under_way[(step > NEAR_M) & (gone[under_way] < np.linalg.norm(eye) + reach)]
    point = eye + gone[:, None] * ray
    beyond = np.sign(point) * np.maximum(np.abs(point) - inner, 0.0)
    length = np.linalg.norm(beyond, axis=1)
    # Steps shrink before they vanish: a ray of the silhouette's last thousandth of a pixel may count either way.
    return beyond / np.maximum(length, 1e-12)[:, None], np.abs(length - radius_m) < 10.0 * NEAR_M


def _distance(point: Array, inner_m: float, radius_m: float) -> Array:
    return np.asarray(np.linalg.norm(np.maximum(np.abs(point) - inner_m, 0.0), axis=1) - radius_m)


def _seen(fine: Array, blur_px: float) -> Array:
    """Blurred by the lens, and averaged over each pixel's area."""
    soft = cv2.GaussianBlur(fine, (0, 0), np.sqrt(blur_px**2 - 1.0 / 12.0) * FINER)
    return np.asarray(soft.reshape(len(fine) // FINER, FINER, -1, FINER).mean((1, 3)))
