"""The first pose, found with no click.

The region that differs from the background gives a place and, by its area, a distance; orientations are tried on a
fixed grid over the rotations that the die's symmetry leaves apart; every trial is scored by how well the drawn die
explains the picture, the best are refined on the edges and scored again. Shadow may or may not be part of the region:
both readings are tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...model.die import Solid
from ...model.rotations import matrix_from_quat
from ..footage import Decimation
from ..picture import (
    COARSE_BLUR_AND_BAND_PX,
    THREADS,
    Blob,
    Mask,
    View,
    differing,
    largest_blob,
    make_view,
    mirror_region_costs,
    new_workspace,
    reflects,
    region_costs,
    seen_by_first,
    stacked,
    without_rims,
    without_shadow,
)
from .refine import Pose, refine_pose

Array = NDArray[np.float64]

ROTATIONS = {"tetrahedron": 12, "cube": 24, "octahedron": 24, "dodecahedron": 60, "icosahedron": 60}
"""Order of each die's rotation group: the grid needs that many times fewer orientations."""
GRID = 12_000
"""Orientations over all rotations, before the symmetry divides them: near enough for the edges to pull a start in."""
FACTORS = (0.92, 1.0, 1.1)
"""On the distance at which a silhouette is as large as the region."""
REFINED = 48
FEW_KEPT, WORSE = 6, 0.3
"""Starts are handed on that score at most so much worse than the best, which other frames may yet turn round, and a few in
any case; never more than the view's quality says."""
SEARCH_PIXELS = 1500
"""Pixels that judge a trial pose."""
PLAIN_SUPPORT = 0.8
"""Share of the contour with a clear step of a start that ends the search: less of it, where the region was that of some faces."""
LARGEST_PX, SEARCHED_PX = 800, 400
"""A die larger than the first is looked for in a smaller picture, where it is about as large as the second: neighbours of
the grid lie some ten degrees apart, and no edge is looked for further away than some ten pixels."""
SHARPEST_PX = 0.3
"""Lens blur of a picture made smaller, at the least: the mean over a pixel."""
ALIKE = 0.05
"""Distance of corners, in edges, below which two poses are one."""
LIT_SHARE = 0.2
"""A region of which less than this is not shadow shows no die."""


def initial_poses(view: View, image: NDArray[np.float32]) -> list[tuple[float, Pose]]:
    """Candidate poses for one frame (height, width), or a stack for several cameras, best first, each with its picture
    score; empty where no die is seen in the first camera."""
    images = image if image.ndim == 3 else image[None]
    if not die_blobs(view, images[0]):
        return []
    found: list[tuple[float, Pose]] = []
    for blobs in _readings(view, images[0]):
        found = sorted([*found, *_found_about(view, images, blobs)], key=lambda pair: pair[0])
        if any(pose.support > PLAIN_SUPPORT for _, pose in found):
            break
    return found


def _found_about(view: View, images: NDArray[np.float32], blobs: list[Blob]) -> list[tuple[float, Pose]]:
    """The starts about some readings of one region, of which not all need be right."""
    if not blobs:
        return []
    # One window for all readings, so that their scores can be compared.
    corners = np.array([blob.box for blob in blobs])
    x0, y0 = (int(v) for v in corners[:, :2].min(0))
    x1, y1 = (int(v) for v in corners[:, 2:].max(0))
    size_px = max(x1 - x0, y1 - y0)
    if size_px > LARGEST_PX:
        return _found_in_smaller(view, images, round(size_px / SEARCHED_PX))
    margin = int(0.2 * size_px) + 6
    width, height = view.camera.width_px, view.camera.height_px
    box = (max(x0 - margin, 0), max(y0 - margin, 0), min(x1 + margin, width), min(y1 + margin, height))
    found = [pair for blob in blobs for pair in _search(view, images, blob, box)]
    found.sort(key=lambda pair: pair[0])
    apart = _apart(view, found)[: view.quality.max_initial_poses]
    kept = apart[:FEW_KEPT] + [pair for pair in apart[FEW_KEPT:] if pair[0] < apart[0][0] + WORSE]
    return [(score, refine_pose(view, images, pose.position_m, pose.rotation)) for score, pose in kept]


def _found_in_smaller(view: View, images: NDArray[np.float32], shrink: int) -> list[tuple[float, Pose]]:
    """The starts that pictures of a part of the size show, each refined on the whole ones."""
    less = Decimation(shrink=shrink)
    sizes = [(camera.height_px, camera.width_px) for camera in view.cameras]
    backgrounds, smaller = (
        [less.picture(picture[:height, :width]) for picture, (height, width) in zip(pictures, sizes, strict=True)]
        for pictures in (view.backgrounds, images)
    )
    small = make_view(
        [less.camera(camera) for camera in view.cameras], view.die, backgrounds, view.noise_grey / shrink,
        view.exposure_s, max(view.blur_px / shrink, SHARPEST_PX), mirror=len(view.rig.weight) > len(view.cameras),
        quality=view.quality,
    )  # fmt: skip
    found = initial_poses(small, stacked(smaller))
    return [(score, refine_pose(view, images, pose.position_m, pose.rotation)) for score, pose in found]


def die_blobs(view: View, image: NDArray[np.float32]) -> list[Blob]:
    """The regions that may be the die, not cut by the image border: with what looks like shadow taken out, and with it."""
    mask, lit = _masks(view, image)
    rest, whole = largest_blob(lit), largest_blob(mask)
    if rest is None or whole is None or rest.area_px < LIT_SHARE * whole.area_px:
        # Nothing but a shadow: it often comes into view before the die that casts it.
        return []
    if rest.touches_border:
        # The die is coming into view, or leaving; what else there is, is its shadow.
        return []
    return [b for b in (rest, largest_blob(mask & (image > view.background)), whole) if b and not b.touches_border]


def _readings(view: View, image: NDArray[np.float32]) -> Iterator[list[Blob]]:
    """Regions that the die alone may be, likely ones first: what is bulky and no shadow, and what is brighter than the table; and
    where none of them shows a die, as of one that is as grey as its shadow, everything that differs."""
    mask, lit = _masks(view, image)
    # Bulky parts are not joined again: a small die and its shadow lie a few pixels apart.
    bulky = largest_blob(without_rims(image, view.background, mask, lit), holes_px=1)
    bright = largest_blob(mask & (image > view.background))
    for readings in ((bulky, bright), (largest_blob(lit), largest_blob(mask))):
        inside = [b for b in readings if b is not None and not b.touches_border]
        yield list({(b.box, b.area_px): b for b in inside}.values())


def _masks(view: View, image: NDArray[np.float32]) -> tuple[Mask, Mask]:
    """What differs from the background, and what of it does not look like a shadow. A mirror shows none: what is dark there is a
    dark face, or the reflection."""
    mask = differing(image, view.background, view.noise_grey)
    return mask, mask if reflects(view) else without_shadow(image, view.background, view.noise_grey, mask)


def _search(
    view: View, images: NDArray[np.float32], blob: Blob, box: tuple[int, int, int, int]
) -> list[tuple[float, Pose]]:
    """Grid search about one blob of the first camera's picture, then refinement of the best on all cameras."""
    solid = view.die.solid
    positions, rotations = _trials(view, blob)
    if not len(positions):
        return []
    cuts = [slice(int(a), int(b)) for a, b in pairwise(np.linspace(0, len(positions), THREADS + 1).astype(int))]
    with ThreadPoolExecutor(THREADS) as pool:
        parts = pool.map(
            lambda part: _scores(view, images[0], box, positions[part], rotations[part], SEARCH_PIXELS)[0], cuts
        )
        scores = np.concatenate(list(parts))
    best = np.argsort(scores, kind="stable")[:REFINED]
    poses = _refined(view, images, positions[best], rotations[best])
    poses = [p for p in poses if p.covariance is not None and p.position_m[2] >= 0.3 * solid.inradius]
    if not poses:
        return []
    places, turns = np.array([p.position_m for p in poses]), np.array([p.rotation for p in poses])
    scores, differs = _scores(view, images[0], box, places, turns, 4 * SEARCH_PIXELS)
    return [
        (float(score) + 2.0 * (1.0 - pose.support) + 10.0 * pose.unexplained, pose)
        for score, share, pose in zip(scores, differs, poses, strict=True)
        if share > 0.4 and pose.support > 0.5
    ]


def _trials(view: View, blob: Blob) -> tuple[Array, Array]:
    """Positions (n, 3) and rotations (n, 3, 3) whose silhouettes are about as large as the blob and lie where it does: each
    orientation of the grid at its own distance, and a little nearer and further for what light and shadow do to the blob."""
    camera, solid = view.camera, view.die.solid
    rotations = _grid(GRID // ROTATIONS.get(solid.name, 12))
    focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
    ray = camera.rotation.T @ _ray(camera.matrix, blob.centre_px)
    windows = ray / np.linalg.norm(ray)
    # Of a convex body the faces that look this way project to its silhouette, each by its area and slant.
    areas, middles = _faces(solid)
    shares = np.maximum(-(solid.normals @ np.swapaxes(rotations, 1, 2)) @ windows, 0.0) * areas
    silhouette_m2 = shares.sum(1)
    middle = np.einsum("nij,nj->ni", rotations, shares @ middles / silhouette_m2[:, None])
    aside = middle - np.outer(middle @ windows, windows)
    depth = focal * np.sqrt(silhouette_m2 / blob.area_px)
    places = np.concatenate([camera.centre_m + np.outer(depth * factor, ray) - aside for factor in FACTORS])
    rotations = np.tile(rotations, (len(FACTORS), 1, 1))
    above = places[:, 2] >= 0.5 * solid.inradius
    return places[above], rotations[above]


def _scores(
    view: View, image: NDArray[np.float32], box: tuple[int, int, int, int], positions_m: Array, rotations: Array,
    samples: int,
) -> tuple[Array, Array]:  # fmt: skip
    """`region_costs`, on a mirror without the shadows that it does not show."""
    scores, differs = region_costs(view, image, box, positions_m, rotations, samples)
    if reflects(view):
        scores = scores + mirror_region_costs(view, image, box, positions_m, rotations, samples)
    return scores, differs


def _refined(view: View, images: NDArray[np.float32], positions_m: Array, rotations: Array) -> list[Pose]:
    """Poses refined on the first camera's picture, whose size of the die may be off by a fifth of the distance, and then on all:
    a second camera sees that error from the side, too far off for any edge to be found."""
    first, loose_m = seen_by_first(view), 1.5 * view.reach_m

    def some(rows: NDArray[np.int64]) -> list[Pose]:
        work = new_workspace(view.shape, view.rig)
        poses = [
            refine_pose(
                first, images, positions_m[k], rotations[k], coarse=len(COARSE_BLUR_AND_BAND_PX), prior_position_m=loose_m,
                prior_rotation_rad=0.3, roughly=True, work=work,
            )
            for k in rows
        ]  # fmt: skip
        if len(view.cameras) == 1:
            return poses
        return [
            refine_pose(view, images, pose.position_m, pose.rotation, coarse=3, work=work)
            for pose in poses
            if pose.covariance is not None
        ]

    with ThreadPoolExecutor(THREADS) as pool:
        parts = pool.map(some, np.array_split(np.arange(len(positions_m)), THREADS))
        return [pose for part in parts for pose in part]


def _apart(view: View, found: list[tuple[float, Pose]]) -> list[tuple[float, Pose]]:
    """One of each group of poses that draw the same picture."""
    kept: list[int] = []
    corners = np.array([_corners(view, pose.position_m, pose.rotation) for _, pose in found])
    for k, mine in enumerate(corners):
        if not _alike(view, mine, corners[kept], ALIKE).any():
            kept.append(k)
    return [found[k] for k in kept]


def same_picture(view: View, here: tuple[Array, Array], there: tuple[Array, Array], within: float = ALIKE) -> bool:
    """Whether two poses (position [m], rotation) draw the same die: every corner of the one `within` so many edges of some
    corner of the other, which the die's symmetry makes likely."""
    return bool(_alike(view, _corners(view, *here), _corners(view, *there)[None], within)[0])


def _corners(view: View, position_m: Array, rotation: Array) -> Array:
    """(v, 3) [m] of the sharp die."""
    return np.asarray(view.die.solid.vertices @ rotation.T + position_m)


def _alike(view: View, corners: Array, others: Array, within: float) -> NDArray[np.bool_]:
    """(n,) which of other dice (n, v, 3) have a corner `within` so many edges of each of the corners (v, 3)."""
    away = np.linalg.norm(corners[:, None] - others[:, None], axis=3).min(axis=2)
    return np.asarray(away.max(axis=1) < within * view.die.solid.edge_m)


def _ray(matrix: Array, pixel: Array) -> Array:
    """Camera ray of unit depth through a pixel; lens distortion is left out, which a start can bear."""
    return np.asarray(np.linalg.solve(matrix, np.array([pixel[0], pixel[1], 1.0])))


def _faces(solid: Solid) -> tuple[Array, Array]:
    """(faces,) areas [m²] and (faces, 3) centroids [m], those of their corners."""
    corners = [solid.vertices[list(face)] for face in solid.faces]
    fans = [np.cross(c[1:-1] - c[0], c[2:] - c[0]) for c in corners]
    areas = [0.5 * float(np.linalg.norm(fan, axis=1).sum()) for fan in fans]
    return np.array(areas), np.array([c.mean(0) for c in corners])


@cache
def _grid(count: int) -> Array:
    """`count` rotations (count, 3, 3) spread evenly: super-Fibonacci spirals (Alexa, CVPR 2022)."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, big = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    a, b = 2.0 * np.pi * s / phi, 2.0 * np.pi * s / psi
    return matrix_from_quat(np.stack([r * np.sin(a), r * np.cos(a), big * np.sin(b), big * np.cos(b)], 1))
