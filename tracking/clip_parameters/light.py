"""The light of a clip: how bright the die's surface looks as a function of its normal, learned on its flat faces.

It predicts the shade of the bevels of a rounded die. A die is convex, so that no part of it shades another. With
distant light, a distant camera and one paint, the brightness of a point then depends on its normal alone, whether the
paint is dull or glossy: a bevel looks as a flat face did in another frame. Faces have thousands of pixels, and their
positions do not depend on contour errors; strips of bevels have a few, in which shade and the position of the edge
are hard to distinguish.

The brightness is a polynomial of degree 4 in the normal, fitted to the median grey level of each face on some frames.
The light that a dull surface reflects is to 99 % of the second degree, whatever its source (Ramamoorthi and Hanrahan,
J. Opt. Soc. Am. A 18, 2448, 2001). Its accuracy comes from cross-validation over parts of the clip, and from the
covariance of the fit for normals that no face had: a die that hardly turns determines little. Marks hardly change the
median of a face.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import ceil

import cv2
import numpy as np
from numpy.typing import NDArray

from ..picture import LAMP_PRIOR, NORMAL_MAD, SPHERE, LightPrior, View, normal_monomials, unknown_light
from ..pose import ClipPoses, Picture, wholly_in_view

Array = NDArray[np.float64]

LIGHT_FRAMES = 96
"""Frames whose faces are used."""
LEAST_VIEW_COSINE = 0.1
"""Least cosine between the normal of a face and the direction to the camera: below it a few pixels remain, within the
blur of the edges."""
FEWEST_FACE_PX = 12
"""Least number of pixels of a face, away from its edges."""
FEWEST_GREYS = 40
"""Least number of face greys to which the polynomial is fitted."""
PARTS = 6
"""Parts of the clip for the cross-validation."""
LEAST_MISFIT = 0.01
"""Least standard deviation of the fit, in units of the median grey."""
MOST_MISFIT = 0.3
"""Standard deviation from which the fit is not used: there are several paints, the light is near, or the die turned
too little."""
CAUCHY_SCALE = 2.0
"""Residual, in standard deviations, at which a face has half its weight."""
REWEIGHTINGS = 8
"""Iterations of the robust weights."""
FIRST_SIGMA = 0.1
"""Standard deviation that the first iteration assumes."""


def with_light(view: View, picture: Picture, poses: ClipPoses) -> View:
    """The view with the light estimated from LIGHT_FRAMES that show the whole die.

    It is the same view for a sharp die, and if the brightness of its faces is no function of their normals. The light
    of mirror images differs and remains unknown.
    """
    if view.die.corner_radius_m == 0.0:
        return view
    light = unknown_light(len(view.rig.camera))
    rows = np.flatnonzero(wholly_in_view(view, poses))
    rows = np.unique(rows[np.linspace(0, len(rows) - 1, min(LIGHT_FRAMES, len(rows))).astype(int)])
    greys = [_face_greys(view, picture(int(k)), poses.position_m[k], poses.rotation[k]) for k in rows]
    for k, camera in enumerate(view.cameras):
        of_frame = [found[k] for found in greys]
        count = np.array([len(found) for found in of_frame], int)
        if count.sum() >= FEWEST_GREYS:
            known = np.concatenate(of_frame)
            frame = np.repeat(np.arange(len(rows)), count)
            _fill_light_of_camera(k, light, known[:, :3], known[:, 3], frame, camera.rotation[2])
    return replace(view, light=light)


def _face_greys(view: View, pictures: NDArray[np.generic], position_m: Array, rotation: Array) -> list[Array]:
    """For each camera (faces in view, 4): normal of each flat face, and the median grey of its pixels away from its
    edges."""
    shape, found = view.shape, []
    normals = shape.normals @ rotation.T
    margin = 1 + ceil(2.0 * view.blur_px)
    for k, camera in enumerate(view.cameras):
        image, background = pictures if pictures.ndim == 2 else pictures[k], view.backgrounds[k]
        toward = position_m - camera.centre_m
        facing = -normals @ toward / np.linalg.norm(toward)
        of_camera = []
        for f in np.flatnonzero(facing > LEAST_VIEW_COSINE):
            corners = np.unique(shape.edges[shape.face_edges[f][shape.face_edges[f] >= 0]])
            flat = (shape.vertices[corners] + shape.radius * shape.normals[f]) @ rotation.T + position_m
            inside = _pixels_inside(camera.project(flat), (camera.width_px, camera.height_px), margin)
            grey = image[inside][np.isfinite(background[inside])] if inside is not None else np.zeros(0)
            if len(grey) >= FEWEST_FACE_PX:
                of_camera.append([*normals[f], float(np.median(grey))])
        found.append(np.array(of_camera).reshape(-1, 4))
    return found


def _pixels_inside(
    corners_px: Array, size: tuple[int, int], margin: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Rows and columns of the pixels within the convex hull of `corners_px` (n, 2), `margin` pixels from its border;
    None if it leaves the picture of a `size` (width, height)."""
    if not np.isfinite(corners_px).all():
        return None
    hull = cv2.convexHull(corners_px.astype(np.float32))[:, 0]
    low, high = np.floor(hull.min(0)).astype(int), np.ceil(hull.max(0)).astype(int)
    if not (low >= 0).all() or not (high < size).all():
        return None
    mask = np.zeros(high[::-1] - low[::-1] + 3, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(hull - low + 1.0).astype(np.int32), 1)
    kept = cv2.erode(mask, np.ones((2 * margin + 1, 2 * margin + 1), np.uint8), borderValue=0)
    rows, columns = np.nonzero(kept)
    return rows + low[1] - 1, columns + low[0] - 1


def _fill_light_of_camera(
    k: int, light: LightPrior, normals: Array, grey: Array, frame: NDArray[np.int64], axis: Array
) -> None:
    """Fill row k of the light with what greys (n,) at normals (n, 3) on frames (n,) show, for a camera with the optical axis
    `axis` (3,). It stays unknown if the greys are no function of the normals, or do not determine it."""
    median = float(np.median(grey))
    A = normal_monomials(normals)
    if not median > 0.0:
        return
    brightness, residual = grey / median, np.zeros(len(grey))
    for low, high in pairwise(np.linspace(0, frame[-1] + 1, PARTS + 1)):
        part = (frame >= low) & (frame < high)
        residual[part] = brightness[part] - A[part] @ _fit_polynomial(A[~part], brightness[~part])[0]
    coefficients, information = _fit_polynomial(A, brightness)
    visible = normal_monomials(SPHERE[SPHERE @ axis < 0.0])
    variance = float(np.einsum("ni,ij,nj->n", visible, np.linalg.inv(information), visible).mean())
    misfit = float(np.hypot(_standard_deviation(residual), np.sqrt(variance)))
    if misfit > MOST_MISFIT:
        return
    light.level[k], light.deviation[k] = median, misfit * median
    light.mean[k] = median * coefficients
    light.information[k] = information / median**2


def _fit_polynomial(A: Array, brightness: Array) -> tuple[Array, Array]:
    """(LIGHT_TERMS,) coefficients of the relative brightness (n,) with rows A, and their information: with a prior, and
    robust against highlights, shadows near the table, and frames with a wrong pose."""
    weight, sigma = np.ones(len(brightness)), FIRST_SIGMA
    for _ in range(REWEIGHTINGS):
        weighted = A.T * weight
        information = weighted @ A / sigma**2 + LAMP_PRIOR
        coefficients = np.asarray(np.linalg.solve(information, weighted @ brightness)) / sigma**2
        residual = brightness - A @ coefficients
        sigma = _standard_deviation(residual)
        weight = 1.0 / (1.0 + (residual / (CAUCHY_SCALE * sigma)) ** 2)
    return coefficients, np.asarray(information)


def _standard_deviation(residual: Array) -> float:
    """Of residuals (n,), by their median absolute value; at least LEAST_MISFIT."""
    return max(NORMAL_MAD * float(np.median(np.abs(residual))), LEAST_MISFIT)
