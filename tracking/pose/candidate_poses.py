"""Candidate poses of one frame, without any input.

The region that differs from the background gives a position and, by its area, a distance. Orientations are taken from a
fixed grid over the rotations that the die's symmetry distinguishes. Every trial gets a region cost; the best are
refined on the edges and compared again. The region may or may not contain shadow: both readings of it are tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, Solid, inner_vertices
from ...model.rotations import matrix_from_quat
from ..footage import Decimation
from ..picture import (
    THREADS,
    Blob,
    Image,
    Mask,
    PixelNoise,
    PoseState,
    View,
    differs_clearly,
    differs_from_background,
    edges_cost,
    largest_blob,
    make_view,
    mirror_region_costs,
    new_workspace,
    region_costs,
    stack_pictures,
    with_first_camera_only,
    without_rims,
    without_shadow,
)
from .refine import Pose, pose_prior, pose_state, refine_pose
from .refine_kernels import COARSE_STEPS

Array = NDArray[np.float64]
Box = tuple[int, int, int, int]

STILL = np.zeros(2)

SYMMETRY_ORDERS = {"tetrahedron": 12, "cube": 24, "octahedron": 24, "dodecahedron": 60, "icosahedron": 60}
"""Order of each die's rotation group: the grid needs that many times fewer orientations."""
LEAST_SYMMETRY_ORDER = 12
"""The same of other shapes."""
GRID_ROTATIONS = 12_000
"""Orientations over all rotations, before the symmetry divides them: neighbours lie near enough for the edges to pull a
trial in. More of them cost time in proportion."""
DISTANCE_FACTORS = (0.92, 1.0, 1.1, 1.25)
"""Factors on the distance at which the silhouette is as large as the region, for what light and shadow do to the
region: a shadow as dark as the die, and beside it, makes it half as large again."""
REFINED = 48
"""Trials of lowest cost that are refined."""
FEW_KEPT = 6
"""Candidates that are kept in any case, up to the limit of the view's quality."""
ACCEPTED_EXCESS_COST = 0.3
"""Further candidates are kept if their cost exceeds the lowest by less: later frames may reverse the order."""
SEARCH_PIXELS = 1500
"""Pixels that the region cost of a trial is taken over."""
JUDGED_PIXELS = 4 * SEARCH_PIXELS
"""The same of a refined trial."""
LEAST_DIFFERING_SHARE = 0.4
"""A refined trial of whose pixels fewer differ from the background shows no die."""
LEAST_SUPPORT = 0.5
"""`Pose.support` below which a refined trial is dropped."""
PLAIN_SUPPORT = 0.8
"""Share of the contour with a clear step of a candidate that ends the search. If less of it is clear, the region was
that of some faces."""
LEAST_HEIGHT = 0.3
"""Height of the centre above the table, in inscribed radii, below which a refined trial is dropped."""
LEAST_TRIAL_HEIGHT = 0.5
"""The same of a trial before its refinement."""
BOX_MARGIN_SHARE = 0.2
"""Margin about the regions in which trials are compared, as a share of the region's size."""
BOX_MARGIN_PX = 6
"""Added to it."""
LARGEST_PX = 800
"""A larger die is searched for in a smaller picture: neighbours of the grid lie some ten degrees apart, and no edge is
found farther away than some ten pixels."""
SEARCHED_PX = 400
"""Size of the die there."""
SHARPEST_PX = 0.3
"""Least lens blur of a smaller picture: the mean over a pixel."""
FIRST_COARSE_STEPS = 2
"""Coarse steps of the first refinement of a candidate."""
APART_EDGES = 0.2
"""Distance of corners, in edges, from which trials of a well-rounded die begin apart: its surface leads from that far."""
SURFACE_TRIALS = 12
"""Most trials that are refined on the whole surface."""
SURFACE_COARSE_STEPS = 4
"""Coarse steps of that refinement."""
SURFACE_COST_RATIO = 1.4
"""Cost over the lowest up to which such a trial is refined further."""
SUPPORTED_ROUNDS = 3
"""Refinements after which it must have LEAST_SUPPORT. Right poses had it from the first on four random clips."""
MOST_ROUNDS = 12
"""Refinements of a candidate one after the other, at the most."""
SETTLED_EDGES = 0.02
"""Movement of a corner by a refinement, in edges, below which a pose stays."""
SAME_DISTANCE = 0.05
"""Relative difference of distances below which two candidates may be one."""
SAME_POSE_EDGES = 0.05
"""Distance of corners, in edges, below which two poses are the same."""
LIT_SHARE = 0.2
"""A region of which a smaller share is not shadow shows no die."""
LEAST_AREA_M2 = 1e-12
"""Least area by which a centroid is divided: the inner polyhedron of a ball is a point."""
SIZE_PRIOR_REACH = 1.5
"""Standard deviation of the prior on a trial's position, in the die's reach: the region's area gives the distance to a
fifth."""
GRID_PRIOR_RAD = 0.3
"""The same of its rotation: a step of the grid."""
ALL_CAMERAS_COARSE_STEPS = 3
"""Coarse steps of the refinement on all cameras that follows that on the first."""


def pose_candidates(view: View, image: Image, rate_px_s: Array = STILL) -> list[tuple[float, Pose]]:
    """Candidate poses of one frame (height, width), or (cameras, height, width) for several cameras: each with its cost
    in the first camera's picture, the lowest first. Empty if the first camera shows no die.

    `rate_px_s` (2,) is the velocity [px/s] of the die in the first camera's picture, whose blur within the exposure makes it
    larger."""
    images = image if image.ndim == 3 else image[None]
    if not die_blobs(view, images[0]):
        return []
    found: list[tuple[float, Pose]] = []
    for blobs in _die_regions(view, images[0]):
        found = sorted([*found, *_candidates_in_regions(view, images, blobs, rate_px_s)], key=lambda pair: pair[0])
        if any(pose.clear_share > PLAIN_SUPPORT for _, pose in found):
            break
    return found


def _candidates_in_regions(view: View, images: Image, blobs: list[Blob], rate_px_s: Array) -> list[tuple[float, Pose]]:
    """Candidates about some readings of one region, of which not all need be right."""
    if not blobs:
        return []
    # One window for all readings makes their costs comparable.
    corners = np.array([blob.box for blob in blobs])
    x0, y0 = (int(v) for v in corners[:, :2].min(0))
    x1, y1 = (int(v) for v in corners[:, 2:].max(0))
    size_px = max(x1 - x0, y1 - y0)
    if size_px > LARGEST_PX:
        return _candidates_in_smaller(view, images, rate_px_s, round(size_px / SEARCHED_PX))
    margin = int(BOX_MARGIN_SHARE * size_px) + BOX_MARGIN_PX
    width, height = view.camera.width_px, view.camera.height_px
    box = (max(x0 - margin, 0), max(y0 - margin, 0), min(x1 + margin, width), min(y1 + margin, height))
    found = [pair for blob in blobs for pair in _search(view, images, blob, box)]
    found.sort(key=lambda pair: pair[0])
    if found and view.shows_surface(found[0][1].position_m):
        kept = _refined_on_surface(view, images, found, rate_px_s)
        settled = [pose for _, pose in _settled(view, images, kept, rate_px_s, 0, on_surface=True)]
        poses = _refined_once_more(view, images, settled, rate_px_s, coarse=0)
        return sorted(((p.cost, p) for p in poses if p.support > LEAST_SUPPORT), key=lambda pair: pair[0])
    distinct = _distinct(view, found)[: view.quality.max_initial_poses]
    limit = distinct[0][0] + ACCEPTED_EXCESS_COST if distinct else 0.0
    kept = distinct[:FEW_KEPT] + [pair for pair in distinct[FEW_KEPT:] if pair[0] < limit]
    return _settled(view, images, kept, rate_px_s, FIRST_COARSE_STEPS)


def _refined_on_surface(
    view: View, images: Image, found: list[tuple[float, Pose]], rate_px_s: Array
) -> list[tuple[float, Pose]]:
    """Of trials refined on the edges of a well-rounded die those that explain its whole surface best, refined on that.

    Edges of such a die have wrong optima, and the region cost draws it with sharp corners: both only say where to begin."""
    apart = _distinct_but_for_distance(view, found, np.inf, APART_EDGES)[:SURFACE_TRIALS]
    prior = pose_prior(SIZE_PRIOR_REACH * view.reach_m, GRID_PRIOR_RAD)
    poses = _refined_once_more(
        view, images, [found[k][1] for k in apart], rate_px_s, coarse=SURFACE_COARSE_STEPS, prior=prior, roughly=True
    )
    poses = [p for p in poses if p.covariance is not None and p.position_m[2] >= LEAST_HEIGHT * view.die.solid.inradius]
    poses.sort(key=lambda pose: pose.cost)
    return [(pose.cost, pose) for pose in poses[:FEW_KEPT] if pose.cost < SURFACE_COST_RATIO * poses[0].cost]


def _settled(
    view: View,
    images: Image,
    found: list[tuple[float, Pose]],
    rate_px_s: Array,
    coarse: int,
    *,
    on_surface: bool = False,
) -> list[tuple[float, Pose]]:
    """Poses refined until they stay; of those that become the same but for their distance, one.

    The prior of a refinement holds the distance of a small or well-rounded die, which its picture hardly shows, and with it
    whatever depends on that: six poses of a cube with corners rounded by a seventh of its edge, 6 to 14 % too far and 7 to 14
    degrees off, came within 2 degrees by twelve refinements, and the first of them led hardly anywhere. Each begins where the one
    before ended, and the first with `coarse` steps. `on_surface` refines those of a well-rounded die
    roughly, and drops the ones that turn out not to be right."""
    settled = [False] * len(found)
    for k in range(MOST_ROUNDS):
        moving = [pose for (_, pose), stays in zip(found, settled, strict=True) if not stays]
        again = iter(_refined_once_more(view, images, moving, rate_px_s, coarse=0 if k else coarse, roughly=on_surface))
        moved = [(cost, pose if stays else next(again)) for (cost, pose), stays in zip(found, settled, strict=True)]
        settled = [_stays(view, before, after) for (_, before), (_, after) in zip(found, moved, strict=True)]
        kept = _distinct_but_for_distance(view, moved, SAME_DISTANCE, SAME_POSE_EDGES)
        if on_surface:
            promising = _promising([pose for _, pose in moved], k + 1)
            kept = [row for row in kept if promising[row]]
        found, settled = [moved[row] for row in kept], [settled[row] for row in kept]
        if all(settled):
            break
    return found


def _promising(poses: list[Pose], rounds: int) -> list[bool]:
    """Whether each of some poses on the surface of a well-rounded die, refined so many times, may be right."""
    least = min((pose.cost for pose in poses), default=0.0)
    return [
        pose.cost < SURFACE_COST_RATIO * least and (rounds < SUPPORTED_ROUNDS or pose.support > LEAST_SUPPORT)
        for pose in poses
    ]


def _refined_once_more(
    view: View, images: Image, poses: list[Pose], rate_px_s: Array, *, coarse: int, prior: Array | None = None,
    roughly: bool = False,
) -> list[Pose]:  # fmt: skip
    """Poses refined with the blur of their motion."""

    def refined(rows: NDArray[np.int64]) -> list[Pose]:
        work = new_workspace(view.shape, view.rig)
        starts = [_moving(view, poses[k], rate_px_s) for k in rows]
        return [refine_pose(view, images, s, coarse=coarse, prior=prior, roughly=roughly, work=work) for s in starts]

    with ThreadPoolExecutor(THREADS) as pool:
        parts = pool.map(refined, np.array_split(np.arange(len(poses)), THREADS))
        return [pose for part in parts for pose in part]


def _moving(view: View, pose: Pose, rate_px_s: Array) -> PoseState:
    """The state of a die that moves across the picture."""
    velocity_m_s = velocity_across_m_s(view, pose.position_m, rate_px_s)
    return pose_state(pose.position_m, pose.rotation, velocity_m_s, np.zeros(3))


def velocity_across_m_s(view: View, position_m: Array, rate_px_s: Array) -> Array:
    """(3,) velocity [m/s] across the line of sight of the first camera that moves a position by so many pixels a second (2,)."""
    camera = view.camera
    depth_m = float((camera.rotation @ (position_m - camera.centre_m))[2])
    across = rate_px_s * depth_m / np.diag(camera.matrix)[:2]
    return np.asarray(camera.rotation[:2].T @ across, float)


def _stays(view: View, before: Pose, after: Pose) -> bool:
    """Whether a refinement moved no corner by SETTLED_EDGES."""
    here, there = (_corners(view, pose.position_m, pose.rotation) for pose in (before, after))
    return bool(np.linalg.norm(there - here, axis=1).max() < SETTLED_EDGES * view.die.solid.edge_m)


def _distinct_but_for_distance(
    view: View, found: list[tuple[float, Pose]], same_distance: float, within: float
) -> list[int]:
    """Of each group of poses that draw the same die at one distance, within a distance of corners in edges, the first; their own
    distances differ by a share of less than `same_distance`."""
    centre_m = view.camera.centre_m
    kept: list[int] = []
    for k, (_, pose) in enumerate(found):
        sight = pose.position_m - centre_m
        distance_m = float(np.linalg.norm(sight))
        for j in kept:
            other = found[j][1]
            other_m = float(np.linalg.norm(other.position_m - centre_m))
            moved = (centre_m + sight * (other_m / distance_m), pose.rotation)
            if abs(other_m / distance_m - 1.0) < same_distance and same_picture(
                view, moved, (other.position_m, other.rotation), within
            ):
                break
        else:
            kept.append(k)
    return kept


def _candidates_in_smaller(view: View, images: Image, rate_px_s: Array, shrink: int) -> list[tuple[float, Pose]]:
    """The candidates of pictures reduced by a factor, each refined on the whole ones."""
    less = Decimation(shrink=shrink)
    sizes = [(camera.height_px, camera.width_px) for camera in view.cameras]
    backgrounds, smaller = (
        [less.picture(picture[:height, :width]) for picture, (height, width) in zip(pictures, sizes, strict=True)]
        for pictures in (view.backgrounds, images)
    )
    small = make_view(
        [less.camera(camera) for camera in view.cameras], view.die, backgrounds,
        PixelNoise(view.noise_grey / shrink, level_grey=view.level_grey), view.exposure_s,
        max(view.blur_px / shrink, SHARPEST_PX), mirror=view.mirror, quality=view.quality,
    )  # fmt: skip
    return _settled(
        view, images, pose_candidates(small, stack_pictures(smaller), rate_px_s / shrink), rate_px_s, FIRST_COARSE_STEPS
    )


def die_blobs(view: View, image: Image) -> list[Blob]:
    """Regions that may be the die and are not cut by the image border: without what looks like shadow, brighter than
    the table, and with the shadow."""
    mask, lit = _masks(view, image)
    rest, whole = largest_blob(lit), largest_blob(mask)
    if rest is None or whole is None or rest.area_px < LIT_SHARE * whole.area_px:
        # Only a shadow, which often comes into view before the die that casts it.
        return []
    if rest.touches_border:
        # The die is entering or leaving the picture; the rest is its shadow.
        return []
    return [b for b in (rest, largest_blob(mask & (image > view.background)), whole) if b and not b.touches_border]


def _die_regions(view: View, image: Image) -> Iterator[list[Blob]]:
    """Regions that the die alone may be, likely ones first: bulky parts without shadow, and parts brighter than the
    table. If none of them shows a die, as of one that is as grey as its shadow, everything that differs follows; and then what
    differs clearly, without the traces that a codec leaves about a die that moves."""
    mask, lit = _masks(view, image)
    # Bulky parts stay separate: a small die and its shadow lie a few pixels apart.
    bulky = largest_blob(without_rims(image, view.background, mask, lit), holes_px=1)
    bright = largest_blob(mask & (image > view.background))
    yield _inside_picture(bulky, bright)
    yield _inside_picture(largest_blob(lit), largest_blob(mask))
    yield _inside_picture(largest_blob(differs_clearly(image, view.background, mask)))


def _inside_picture(*readings: Blob | None) -> list[Blob]:
    """Those regions that exist and are not cut by the border, each once."""
    inside = [blob for blob in readings if blob is not None and not blob.touches_border]
    return list({(blob.box, blob.area_px): blob for blob in inside}.values())


def _masks(view: View, image: Image) -> tuple[Mask, Mask]:
    """What differs from the background, and what of it does not look like a shadow. A mirror shows no shadow: dark
    parts there are dark faces, or the reflection."""
    mask = differs_from_background(image, view.background, view.noise_grey, view.level_grey)
    return mask, mask if view.mirror else without_shadow(image, view.background, view.noise_grey, mask)


def _search(view: View, images: Image, blob: Blob, box: Box) -> list[tuple[float, Pose]]:
    """Grid search about one blob of the first camera's picture, then refinement of the best trials on all cameras."""
    solid = view.die.solid
    positions, rotations = _trials(view, blob)
    if not len(positions):
        return []
    cuts = [slice(int(a), int(b)) for a, b in pairwise(np.linspace(0, len(positions), THREADS + 1).astype(int))]
    with ThreadPoolExecutor(THREADS) as pool:
        parts = pool.map(
            lambda part: region_costs_on(view, images[0], box, positions[part], rotations[part], SEARCH_PIXELS)[0], cuts
        )
        costs = np.concatenate(list(parts))
    best = np.argsort(costs, kind="stable")[:REFINED]
    poses = _refined_trials(view, images, positions[best], rotations[best])
    poses = [p for p in poses if p.covariance is not None and p.position_m[2] >= LEAST_HEIGHT * solid.inradius]
    if not poses:
        return []
    places, turns = np.array([p.position_m for p in poses]), np.array([p.rotation for p in poses])
    costs, differs = region_costs_on(view, images[0], box, places, turns, JUDGED_PIXELS)
    return [
        (float(cost) + edges_cost(pose.clear_share, pose.unexplained), pose)
        for cost, share, pose in zip(costs, differs, poses, strict=True)
        if share > LEAST_DIFFERING_SHARE and pose.support > LEAST_SUPPORT
    ]


def _trials(view: View, blob: Blob) -> tuple[Array, Array]:
    """Positions (n, 3) and rotations (n, 3, 3) whose silhouettes have about the area and the centre of the blob: each
    orientation of the grid at its own distance, and a little nearer and farther."""
    camera, solid = view.camera, view.die.solid
    rotations = _rotation_grid(GRID_ROTATIONS // SYMMETRY_ORDERS.get(solid.name, LEAST_SYMMETRY_ORDER))
    focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
    ray = camera.rotation.T @ _ray(camera.matrix, blob.centre_px)
    line_of_sight = ray / np.linalg.norm(ray)
    silhouette_m2, middle = _silhouettes(view.die, rotations, line_of_sight)
    aside = middle - np.outer(middle @ line_of_sight, line_of_sight)
    depth = focal * np.sqrt(silhouette_m2 / blob.area_px)
    places = np.concatenate([camera.centre_m + np.outer(depth * factor, ray) - aside for factor in DISTANCE_FACTORS])
    rotations = np.tile(rotations, (len(DISTANCE_FACTORS), 1, 1))
    above = places[:, 2] >= LEAST_TRIAL_HEIGHT * solid.inradius
    return places[above], rotations[above]


def region_costs_on(
    view: View, image: Image, box: Box, positions_m: Array, rotations: Array,
    samples: int,
) -> tuple[Array, Array]:  # fmt: skip
    """`region_costs` on any table; on a mirror the shadows that it does not show are added."""
    costs, differs = region_costs(view, image, box, positions_m, rotations, samples)
    if view.mirror:
        costs = costs + mirror_region_costs(view, image, box, positions_m, rotations, samples)
    return costs, differs


def _refined_trials(view: View, images: Image, positions_m: Array, rotations: Array) -> list[Pose]:
    """Poses refined on the first camera's picture, and then on all cameras.

    The distance may be off by a fifth at first. A second camera sees that error from the side, too far off for any edge
    to be found.
    """
    first, prior = with_first_camera_only(view), pose_prior(SIZE_PRIOR_REACH * view.reach_m, GRID_PRIOR_RAD)

    def refined(rows: NDArray[np.int64]) -> list[Pose]:
        work = new_workspace(view.shape, view.rig)
        poses = [
            refine_pose(
                first, images, pose_state(positions_m[k], rotations[k]), coarse=COARSE_STEPS, prior=prior, roughly=True,
                edges_alone=True, work=work,
            )
            for k in rows
        ]  # fmt: skip
        if len(view.cameras) == 1:
            return poses
        return [
            refine_pose(
                view,
                images,
                pose_state(pose.position_m, pose.rotation),
                coarse=ALL_CAMERAS_COARSE_STEPS,
                edges_alone=True,
                work=work,
            )
            for pose in poses
            if pose.covariance is not None
        ]

    with ThreadPoolExecutor(THREADS) as pool:
        parts = pool.map(refined, np.array_split(np.arange(len(positions_m)), THREADS))
        return [pose for part in parts for pose in part]


def _distinct(view: View, found: list[tuple[float, Pose]]) -> list[tuple[float, Pose]]:
    """One of each group of poses that draw the same picture."""
    kept: list[int] = []
    corners = np.array([_corners(view, pose.position_m, pose.rotation) for _, pose in found])
    for k, mine in enumerate(corners):
        if not _same_pose(view, mine, corners[kept], SAME_POSE_EDGES).any():
            kept.append(k)
    return [found[k] for k in kept]


def same_picture(
    view: View, here: tuple[Array, Array], there: tuple[Array, Array], within: float = SAME_POSE_EDGES
) -> bool:
    """Whether two poses (position [m], rotation) draw the same die: every corner of one lies `within` so many edges of
    some corner of the other, which the symmetry of the die makes likely."""
    return bool(_same_pose(view, _corners(view, *here), _corners(view, *there)[None], within)[0])


def _corners(view: View, position_m: Array, rotation: Array) -> Array:
    """(v, 3) [m] of the sharp die."""
    return np.asarray(view.die.solid.vertices @ rotation.T + position_m)


def _same_pose(view: View, corners: Array, others: Array, within: float) -> NDArray[np.bool_]:
    """(n,) which of other dice (n, v, 3) have a corner `within` so many edges of each of the corners (v, 3)."""
    away = np.linalg.norm(corners[:, None] - others[:, None], axis=3).min(axis=2)
    return np.asarray(away.max(axis=1) < within * view.die.solid.edge_m)


def _ray(matrix: Array, pixel: Array) -> Array:
    """Camera ray of unit depth through a pixel, without lens distortion, which a trial need not know."""
    return np.asarray(np.linalg.solve(matrix, np.array([pixel[0], pixel[1], 1.0])))


def _silhouettes(die: Die, rotations: Array, line_of_sight: Array) -> tuple[Array, Array]:
    """Areas (n,) [m²] of the silhouettes of a die in orientations (n, 3, 3), seen from afar along a unit vector (3,), and their
    centroids (n, 3) [m] from the centre of the die.

    The visible faces of the inner polyhedron project to its silhouette, each by its area and slant; the balls that roll over it
    widen that by the corner radius r all round, to A + P r + π r² with its perimeter P (Steiner). The centroid is that of A."""
    solid, r = die.solid, die.corner_radius_m
    inner = inner_vertices(solid, r)
    areas, middles = _face_areas(inner, solid)
    facing = -(solid.normals @ np.swapaxes(rotations, 1, 2)) @ line_of_sight
    shares = np.maximum(facing, 0.0) * areas
    silhouette_m2 = shares.sum(1)
    middle = np.einsum("nij,nj->ni", rotations, shares @ middles / np.maximum(silhouette_m2, LEAST_AREA_M2)[:, None])
    if r == 0.0:
        return silhouette_m2, middle
    along = rotations @ (inner[solid.edges[:, 1]] - inner[solid.edges[:, 0]]).T
    lengths = np.linalg.norm(np.cross(along, line_of_sight, axisa=1), axis=2)
    is_outline = (facing > 0.0)[:, solid.edge_faces].sum(axis=2) == 1
    return silhouette_m2 + r * (lengths * is_outline).sum(1) + np.pi * r**2, middle


def _face_areas(vertices: Array, solid: Solid) -> tuple[Array, Array]:
    """(faces,) areas [m²] and (faces, 3) centroids [m] of the faces of a solid whose corners lie at these vertices (v, 3); the
    centroids are those of their corners."""
    corners = [vertices[list(face)] for face in solid.faces]
    fans = [np.cross(c[1:-1] - c[0], c[2:] - c[0]) for c in corners]
    areas = [0.5 * float(np.linalg.norm(fan, axis=1).sum()) for fan in fans]
    return np.array(areas), np.array([c.mean(0) for c in corners])


@cache
def _rotation_grid(count: int) -> Array:
    """`count` rotations (count, 3, 3) spread evenly: super-Fibonacci spirals (Alexa, CVPR 2022)."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, big = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    a, b = 2.0 * np.pi * s / phi, 2.0 * np.pi * s / psi
    return matrix_from_quat(np.stack([r * np.sin(a), r * np.cos(a), big * np.sin(b), big * np.cos(b)], 1))
