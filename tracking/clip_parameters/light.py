"""How bright a die looks by where its surface turns, as its flat faces show it: what the bevels of a rounded one must look like.

A die is convex, so that nothing of it shades another part. In light from afar, seen from afar and of one paint, each of its
points then is as bright as its normal says, be the paint dull or glossy, and what a flat face shows in one frame a bevel shows in
another. Faces have thousands of pixels, and lie where they lie whatever a contour errs; the strips of bevels have a few, in
which their shades and the place of the edge look much alike.

The brightness is a polynomial of degree 4 of the normal, fitted to the middling grey of each face on some frames: what light from
anywhere on a dull surface gives is to 99 % of the second degree (Ramamoorthi and Hanrahan, J. Opt. Soc. Am. A 18, 2448, 2001).
How far it may be trusted is asked of parts of the clip that it was not fitted to, and of the fit itself for normals that no face
had: a die that hardly turns tells little. Marks hardly move the median of a face.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import ceil

import cv2
import numpy as np
from numpy.typing import NDArray

from ..picture import LIGHT_DEGREE, View
from ..picture import LIGHT_TERMS as TERMS
from ..pose import ClipPoses, Picture, shown_whole

Array = NDArray[np.float64]

LIGHT_FRAMES = 96
"""Frames whose faces are asked."""
GLANCE = 0.1
"""Least cosine at which a face is seen: its grey then is that of a few pixels, amid the blur of its edges."""
FEWEST_PX = 12
"""Least pixels of a face, away from its edges."""
FEWEST_FACES = 40
"""Below that many greys no polynomial is fitted."""
PARTS = 6
"""Parts of the clip, each of which is foretold from the others."""
LAMP = np.array([10.0, 2.0, 1.25, 0.5, 0.4])
"""One sigma of each degree's share in the brightness, in its mean: a lamp on a dull surface gives 1, 2, 1.25, 0 and -0.375 times
the polynomials of Legendre in the cosine of the angle to it; how bright the whole is, nobody knows."""
LEAST_MISFIT = 0.01
"""Least misfit that is believed, in middling greys."""
MOST_MISFIT = 0.3
"""A misfit beyond which the paint is not one, the light not from afar, or the die turned too little, and bevels are left to
themselves."""
CAUCHY, TURNS = 2.0, 8
"""Misfits at which a face counts half, and times that the fit is repeated with weights from the last."""
DARK = 0.5
"""Least brightness that is believed, in that of the darkest faces."""


def with_light(view: View, picture: Picture, seen: ClipPoses) -> View:
    """The view with what some frames that show the whole die tell of the light; the same for a sharp die, and where the
    brightness of its faces is no function of their normals. Views in a mirror are lit otherwise, and show no faces from above:
    nothing is known there."""
    if view.die.corner_radius_m == 0.0:
        return view
    light = np.zeros_like(view.light)
    rows = np.flatnonzero(shown_whole(view, seen))
    rows = np.unique(rows[np.linspace(0, len(rows) - 1, min(LIGHT_FRAMES, len(rows))).astype(int)])
    greys = [_greys(view, picture(int(k)), seen.position_m[k], seen.rotation[k]) for k in rows]
    for k, camera in enumerate(view.cameras):
        of_frame = [found[k] for found in greys]
        count = np.array([len(found) for found in of_frame], int)
        if count.sum() >= FEWEST_FACES:
            known = np.concatenate(of_frame)
            frame = np.repeat(np.arange(len(rows)), count)
            light[k] = _fitted(known[:, :3], known[:, 3], frame, camera.rotation[2])
    return replace(view, light=light)


def _greys(view: View, pictures: NDArray[np.generic], position_m: Array, rotation: Array) -> list[Array]:
    """(faces seen, 4) normal and grey of each flat face that each camera sees: the median of its pixels away from its edges."""
    shape, found = view.shape, []
    normals = shape.normals @ rotation.T
    margin = 1 + ceil(2.0 * view.blur_px)
    for k, camera in enumerate(view.cameras):
        image, background = pictures if pictures.ndim == 2 else pictures[k], view.backgrounds[k]
        sight = position_m - camera.centre_m
        facing = -normals @ sight / np.linalg.norm(sight)
        some = []
        for f in np.flatnonzero(facing > GLANCE):
            corners = np.unique(shape.edges[shape.face_edges[f][shape.face_edges[f] >= 0]])
            flat = (shape.vertices[corners] + shape.radius * shape.normals[f]) @ rotation.T + position_m
            inside = _inside(camera.project(flat), (camera.width_px, camera.height_px), margin)
            grey = image[inside][np.isfinite(background[inside])] if inside is not None else np.zeros(0)
            if len(grey) >= FEWEST_PX:
                some.append([*normals[f], float(np.median(grey))])
        found.append(np.array(some).reshape(-1, 4))
    return found


def _inside(
    corners_px: Array, size: tuple[int, int], margin: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Rows and columns of the pixels of a picture (width, height) that lie within a convex outline (n, 2), `margin` pixels from
    its border; None where that leaves the picture."""
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


def _fitted(normals: Array, grey: Array, frame: NDArray[np.int64], sight: Array) -> Array:
    """(TERMS + 2,) what the kernels want of greys (n,) at normals (n, 3) on frames (n,), for a camera that looks along `sight`
    (3,); zero where they are no function of the normals, or say too little of it."""
    middle = float(np.median(grey))
    known, A = np.zeros(TERMS + 2), basis(normals)
    if not middle > 0.0:
        return known
    shade, left = grey / middle, np.zeros(len(grey))
    for low, high in pairwise(np.linspace(0, frame[-1] + 1, PARTS + 1)):
        asked = (frame >= low) & (frame < high)
        left[asked] = shade[asked] - A[asked] @ _polynomial(A[~asked], shade[~asked])[0]
    found, covariance = _polynomial(A, shade)
    shown = basis(_SPHERE[_SPHERE @ sight < 0.0])
    unsure = float(np.einsum("ni,ij,nj->n", shown, covariance, shown).mean())
    misfit = float(np.hypot(_scale(left), np.sqrt(unsure)))
    if misfit > MOST_MISFIT:
        return known
    known[:TERMS] = middle * found
    known[TERMS:] = DARK * max(float(np.quantile(grey, 0.02)), 1e-3 * middle), misfit * middle
    return known


def _polynomial(A: Array, shade: Array) -> tuple[Array, Array]:
    """(TERMS,) coefficients of greys (n,) over their middle, and their covariance (TERMS, TERMS): with a prior, and robustly
    against highlights, shadows near the table, and frames whose pose is wrong."""
    weight, scale = np.ones(len(shade)), 0.1
    for _ in range(TURNS):
        weighted = A.T * weight
        covariance = np.linalg.inv(weighted @ A / scale**2 + _PRIOR)
        found = np.asarray(covariance @ (weighted @ shade)) / scale**2
        left = shade - A @ found
        scale = _scale(left)
        weight = 1.0 / (1.0 + (left / (CAUCHY * scale)) ** 2)
    return found, np.asarray(covariance)


def _scale(left: Array) -> float:
    """Standard deviation of what is left (n,), by its median size."""
    return max(1.4826 * float(np.median(np.abs(left))), LEAST_MISFIT)


_POWERS = [
    (i, j, k)
    for i in range(LIGHT_DEGREE + 1)
    for j in range(LIGHT_DEGREE + 1 - i)
    for k in range(2 if i + j < LIGHT_DEGREE else 1)
]


def basis(normals: Array) -> Array:
    """(n, TERMS) the products xⁱ yʲ zᵏ of normals (n, 3), in the order of `edges`: k to 1 alone, since z² is 1 - x² - y²."""
    x, y, z = normals.T
    return np.stack([x**i * y**j * z**k for i, j, k in _POWERS], axis=1)


def _over_the_sphere(count: int) -> Array:
    """(count, 3) unit vectors, as evenly spread as a golden spiral has them."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z * z)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


_SPHERE = _over_the_sphere(200)


def _prior() -> Array:
    """(TERMS, TERMS) information of lamps of which nobody knows where they hang: by the addition theorem, degree l of a function
    on the sphere is Σ a² P_l(n · n')/(2 l + 1) alike at n and n'."""
    alike = np.polynomial.legendre.legval(_SPHERE @ _SPHERE.T, LAMP**2 / (2.0 * np.arange(LIGHT_DEGREE + 1) + 1.0))
    back = np.linalg.pinv(basis(_SPHERE))
    return np.asarray(np.linalg.inv(back @ alike @ back.T))


_PRIOR = _prior()
