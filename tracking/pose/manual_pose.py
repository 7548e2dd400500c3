"""Manual initialisation: a pose or clicks that a person gives for one frame, and frames that a person excludes.

Clicks with the numbers of their vertices give a pose by perspective-n-point (SQPnP: Terzakis and Lourakis, ECCV 2020).
Clicks without numbers are matched by exhaustive hypothesise and verify. The first three are assigned to every triple of
vertices that the die's symmetry distinguishes, each with the up to four poses of three points (P3P); poses that put
every other click on a visible corner are kept. The best few are refined on the edges of the picture, and the one of
lowest cost is taken, because four corners of one face do not distinguish it from its mirror image in tilt.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ...model.die import nearest_equivalent_rotation
from ...model.errors import InputError
from ...model.rotations import matrix_from_quat
from ..picture import View, visible_faces
from .refine import Pose, pose_prior, pose_state, refine_pose
from .refine_kernels import COARSE_STEPS

Array = NDArray[np.float64]
Image = NDArray[np.float32]

FEWEST_CLICKS = 4
"""Three corners leave up to four poses; the fourth decides."""
CLICK_PX = 12.0
"""Largest distance of a click from its corner: a hand is good to a few pixels, and rounded corners have no exact
point."""
UNREFINED_CLICK_BLUNDERS = 3.0
"""The same, in CLICK_PX, before the pose of three clicks is fitted to all: their errors reach the other corners with
some leverage."""
REFINED = 4
"""Poses from clicks that are refined on the picture."""
SAME_POSE_EDGES = 0.05
"""Poses whose corners all lie nearer than this, in edges, draw the same die."""
PRIOR_M = 2e-2
"""Standard deviation of the prior on the refined position: it only holds a direction that the pixels leave open."""
PRIOR_RAD = 0.3
"""The same of the rotation."""
LEAST_SUPPORT = 0.5
"""`Pose.support` from which the picture confirms the pose; random poses have 0.1 to 0.3 on edges."""
LEAST_HEIGHT = 0.5
"""Height of the centre above the table, in inscribed radii, below which a pose from clicks is dropped. A click moves
the depth by a share of the die's size; half an inscribed radius is more than that."""
FLAT_SHARE = 1e-3
"""Clicked vertices lie in a plane if their thickness is less, in units of the die's reach."""
NO_PIXEL_PX = 1e4
"""Distance of a click from a corner that stands for any larger one."""


@dataclass(frozen=True, eq=False)
class Click:
    """A corner of the die that a person clicked on a frame."""

    px: Array
    """(2,) x, y; pixel centres at integers."""
    vertex: int | None = None
    """Its number in vertices.csv; None if it is not given."""


@dataclass(frozen=True, eq=False)
class ManualInitialisation:
    """The pose on one frame as a person gives it: the pose itself, or clicks."""

    frame: int
    """Number in the file, as in track.csv."""
    position_m: Array | None = None
    """(3,) of the centre, in the world."""
    quaternion: Array | None = None
    """(4,) wxyz, body to world."""
    clicks: tuple[Click, ...] = ()
    """At least FEWEST_CLICKS if no pose is given; with vertices for all or for none."""


def manual_initial_pose(view: View, image: Image, start: ManualInitialisation) -> Pose:
    """The pose on the frame `image` (height, width), refined on its edges from the given pose or clicks.

    Raises ValueError if no pose of the die matches the clicks, or the frame does not confirm the pose.
    """
    prior = pose_prior(PRIOR_M, PRIOR_RAD)
    found = [
        refine_pose(view, image, pose_state(position, rotation), coarse=COARSE_STEPS, prior=prior)
        for position, rotation in _given_poses(view, start)
    ]
    confirmed = [pose for pose in found if pose.covariance is not None and pose.support >= LEAST_SUPPORT]
    if not confirmed:
        best = max((pose.support for pose in found), default=0.0)
        raise InputError(
            f"start.frame = {start.frame}: the picture shows {100 * best:.0f} % of what should be clear of the contour of a "
            f"{view.die.solid.name} there, wanted at least {100 * LEAST_SUPPORT:.0f} %; check the frame's number, and the pose "
            "or clicks"
        )
    pose = min(confirmed, key=lambda each: each.cost)
    return _labelled_as_given(view, pose, start)


def _given_poses(view: View, start: ManualInitialisation) -> list[tuple[Array, Array]]:
    """Poses to refine: position and rotation."""
    if start.position_m is not None and start.quaternion is not None:
        return [(start.position_m, matrix_from_quat(start.quaternion))]
    return poses_from_clicks(view, start)


def poses_from_clicks(view: View, start: ManualInitialisation) -> list[tuple[Array, Array]]:
    """Positions (3,) and rotations (3, 3) that put corners of the die on the clicks, best first.

    Raises ValueError if there are too few clicks, or if no pose comes within CLICK_PX of all of them.
    """
    if len(start.clicks) < FEWEST_CLICKS:
        raise InputError(f"start.corners has {len(start.clicks)} clicks; wanted {FEWEST_CLICKS} or more")
    pixels = np.array([click.px for click in start.clicks], float)
    named = [click.vertex for click in start.clicks if click.vertex is not None]
    trials = (
        _poses_of_named(view, np.array(named), pixels) if len(named) == len(pixels) else _poses_of_unnamed(view, pixels)
    )
    found = sorted(trials, key=lambda trial: trial[0])
    if not found or found[0][0] > CLICK_PX:
        off = f"the nearest is {found[0][0]:.0f} px off" if found else "none lies before the camera"
        raise InputError(
            f"start.corners: no pose of a {view.die.solid.name} of this size puts its corners on the {len(pixels)} clicks "
            f"({off}); check the frame's number, the clicks and their vertices"
        )
    return _distinct(view, [(position, rotation) for rms, position, rotation in found if rms <= CLICK_PX])


def _poses_of_named(view: View, vertices: NDArray[np.int64], pixels: Array) -> Iterator[tuple[float, Array, Array]]:
    """Poses from clicks whose vertices are known: residual [px], position, rotation."""
    points = view.die.solid.vertices[vertices]
    matrix, distortion = view.camera.matrix, view.camera.distortion
    flat = np.linalg.matrix_rank(points - points.mean(0), tol=FLAT_SHARE * view.reach_m) < 3
    method = cv2.SOLVEPNP_IPPE if flat else cv2.SOLVEPNP_SQPNP
    # The planar method takes points in the axes of their plane.
    axes = np.linalg.svd(points - points.mean(0))[2]
    axes = axes if np.linalg.det(axes) > 0 else -axes
    local = (points - points.mean(0)) @ axes.T
    local[:, 2] *= not flat
    count, turns, shifts, _ = cv2.solvePnPGeneric(local, pixels, matrix, distortion, flags=method)
    for turn, shift in zip(turns[:count], shifts[:count], strict=True):
        yield from _fitted_to_clicks(view, local, pixels, turn, shift, axes, points.mean(0))


def _poses_of_unnamed(view: View, pixels: Array) -> Iterator[tuple[float, Array, Array]]:
    """The same for clicks whose vertices are not known. The first gets vertex 0, because a regular die looks the same
    from each."""
    vertices, camera = view.die.solid.vertices, view.camera
    wide = _spread_first(pixels)
    for second, third in itertools.permutations(range(1, len(vertices)), 2):
        triple = vertices[[0, second, third]]
        _, turns, shifts = cv2.solveP3P(
            triple, pixels[wide[:3]], camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_P3P
        )
        for turn, shift in zip(turns, shifts, strict=True):
            position, rotation = _in_world(view, cv2.Rodrigues(turn)[0], shift.ravel())
            names = _nearest_corners(view, position, rotation, pixels)
            if names is not None:
                yield from _fitted_to_clicks(view, vertices[names], pixels, turn, shift, np.eye(3), np.zeros(3))


def _spread_first(pixels: Array) -> NDArray[np.int64]:
    """Order of the clicks in which the first three span the largest triangle: their pose is the surest."""

    def area(three: tuple[int, ...]) -> float:
        (ax, ay), (bx, by) = pixels[three[1]] - pixels[three[0]], pixels[three[2]] - pixels[three[0]]
        return abs(ax * by - ay * bx)

    first = max(itertools.combinations(range(len(pixels)), 3), key=area)
    return np.array([*first, *(k for k in range(len(pixels)) if k not in first)])


def _nearest_corners(view: View, position: Array, rotation: Array, pixels: Array) -> NDArray[np.int64] | None:
    """Vertices of the visible corners next to the clicks, each corner once; None if a click lies far from all that are
    left."""
    faces = visible_faces(view, position, rotation)
    seen = np.unique([corner for f in faces for corner in view.die.solid.faces[f]])
    if len(seen) < len(pixels):
        return None
    drawn = view.camera.project(view.die.solid.vertices[seen] @ rotation.T + position)
    if not np.isfinite(drawn).all():
        return None
    apart = np.linalg.norm(pixels[:, None] - drawn[None], axis=2)
    clicks, corners = linear_sum_assignment(np.minimum(apart, NO_PIXEL_PX))
    return (
        None
        if apart[clicks, corners].max() > UNREFINED_CLICK_BLUNDERS * CLICK_PX
        else np.asarray(seen[corners], np.int64)
    )


def _fitted_to_clicks(
    view: View, points: Array, pixels: Array, turn: Array, shift: Array, axes: Array, middle: Array
) -> Iterator[tuple[float, Array, Array]]:
    """Least squares over all clicks from a first pose of points in their own axes; nothing if it ends below the table
    or behind the camera."""
    matrix, distortion = view.camera.matrix, view.camera.distortion
    turn, shift = cv2.solvePnPRefineLM(points, pixels, matrix, distortion, turn.copy(), shift.copy())
    R = np.asarray(cv2.Rodrigues(turn)[0] @ axes, float)
    position, rotation = _in_world(view, R, np.asarray(shift, float).ravel() - R @ middle)
    drawn = view.camera.project((points @ axes + middle) @ rotation.T + position)
    rms = float(np.sqrt(((drawn - pixels) ** 2).sum(1).mean()))
    if np.isfinite(rms) and position[2] > LEAST_HEIGHT * view.die.solid.inradius:
        yield rms, position, rotation


def _in_world(view: View, rotation: Array, shift: Array) -> tuple[Array, Array]:
    """A pose in camera axes, in the world."""
    R, t = view.camera.rotation, view.camera.translation_m
    return np.asarray(R.T @ (shift - t), float), np.asarray(R.T @ rotation, float)


def _distinct(view: View, poses: list[tuple[Array, Array]]) -> list[tuple[Array, Array]]:
    """The first REFINED poses that draw different dice."""
    kept: list[tuple[Array, Array]] = []
    drawn: list[Array] = []
    for position, rotation in poses:
        corners = view.die.solid.vertices @ rotation.T + position
        near = SAME_POSE_EDGES * view.die.solid.edge_m
        if any(np.linalg.norm(corners[:, None] - other[None], axis=2).min(1).max() < near for other in drawn):
            continue
        kept.append((position, rotation))
        drawn.append(corners)
        if len(kept) == REFINED:
            break
    return kept


def _labelled_as_given(view: View, pose: Pose, start: ManualInitialisation) -> Pose:
    """The refined pose in the labelling of the given orientation, if there is one."""
    if start.quaternion is None:
        return pose
    turned = nearest_equivalent_rotation(pose.rotation, matrix_from_quat(start.quaternion), view.symmetries)
    return replace(pose, rotation=turned)


def excluded_rows(ranges: Sequence[tuple[int, int]], first_frame: int, count: int) -> frozenset[int]:
    """Rows (0 ... count - 1) of a clip that begins at frame `first_frame` whose frame numbers lie in ranges (first, end
    exclusive)."""
    left_out = np.zeros(count, bool)
    for first, stop in ranges:
        left_out[max(first - first_frame, 0) : max(stop - first_frame, 0)] = True
    return frozenset(int(k) for k in np.flatnonzero(left_out))
