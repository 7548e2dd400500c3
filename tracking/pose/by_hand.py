"""The first pose from what a person gives: a pose, or clicks on corners of the die.

Clicks with the numbers of their vertices give a pose by perspective-n-point (SQPnP: Terzakis and Lourakis, ECCV 2020). Clicks
without numbers are named by trial: the first three are given to every triple of vertices that the die's symmetry leaves
apart, each with the up to four poses of three points (P3P), and the poses that put every other click on a visible corner
too are kept; this is hypothesise and verify with no chance in it. The best few are refined on the picture's edges, and that
which explains the picture best is taken, since four corners of one face cannot tell it from its mirror image in tilt.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ...model.die import nearest_equivalent_rotation
from ...model.rotations import matrix_from_quat
from ..picture import COARSE_BLUR_AND_BAND_PX, View, visible_faces
from .manual_input import FEWEST_CLICKS, ManualInitialisation
from .refine import Pose, refine_pose

Array = NDArray[np.float64]
Image = NDArray[np.float32]

CLICK_PX = 12.0
"""How far a click may lie from its corner: a hand is good to a few pixels, and rounded corners have no point to hit."""
TRIED = 4
"""Poses from clicks that are refined on the picture."""
APART_SHARE = 0.05
"""Of an edge: poses whose corners all lie nearer than this draw the same die."""
LOOSE_M, LOOSE_RAD = 2e-2, 0.3
"""Prior of the refinement: too weak to hold it, it only keeps a direction that the pixels leave open."""
LEAST_SUPPORT = 0.5
"""Share of the contour that must show a clear step for the picture to bear the pose out; random poses have 0.1 to 0.3."""


def manual_initial_pose(view: View, image: Image, start: ManualInitialisation) -> Pose:
    """The pose on the frame `image` (height, width), refined on its edges from what was given.

    Raises ValueError, in one sentence, where the clicks are no picture of the die, or the frame does not bear the pose out.
    """
    found = [
        refine_pose(
            view,
            image,
            position,
            rotation,
            coarse=len(COARSE_BLUR_AND_BAND_PX),
            prior_position_m=LOOSE_M,
            prior_rotation_rad=LOOSE_RAD,
        )
        for position, rotation in _given(view, start)
    ]
    sure = [pose for pose in found if pose.covariance is not None and pose.support >= LEAST_SUPPORT]
    if not sure:
        best = max((pose.support for pose in found), default=0.0)
        raise ValueError(
            f"start.frame = {start.frame}: the picture shows {100 * best:.0f} % of the contour of a {view.die.solid.name} "
            f"there, wanted {100 * LEAST_SUPPORT:.0f} % at least; look at the frame's number and at the pose or clicks"
        )
    pose = min(sure, key=lambda each: each.cost)
    return _labelled_as_given(view, pose, start)


def _given(view: View, start: ManualInitialisation) -> list[tuple[Array, Array]]:
    """Poses to refine: position and rotation."""
    if start.position_m is not None and start.quaternion is not None:
        return [(start.position_m, matrix_from_quat(start.quaternion))]
    return poses_from_clicks(view, start)


def poses_from_clicks(view: View, start: ManualInitialisation) -> list[tuple[Array, Array]]:
    """Positions (3,) and rotations (3, 3) that put corners of the die on the clicks, best first.

    Raises ValueError where there are too few clicks, or no pose comes within CLICK_PX of all of them.
    """
    if len(start.clicks) < FEWEST_CLICKS:
        raise ValueError(f"start.corners has {len(start.clicks)} clicks; wanted {FEWEST_CLICKS} or more")
    pixels = np.array([click.px for click in start.clicks], float)
    named = [click.vertex for click in start.clicks if click.vertex is not None]
    trials = _named(view, np.array(named), pixels) if len(named) == len(pixels) else _unnamed(view, pixels)
    found = sorted(trials, key=lambda trial: trial[0])
    if not found or found[0][0] > CLICK_PX:
        off = f"the nearest is {found[0][0]:.0f} px off" if found else "none lies before the camera"
        raise ValueError(
            f"start.corners: no pose of a {view.die.solid.name} of this size puts its corners on the {len(pixels)} clicks "
            f"({off}); look at the frame's number, the clicks and their vertices"
        )
    return _apart(view, [(position, rotation) for rms, position, rotation in found if rms <= CLICK_PX])


def _named(view: View, vertices: NDArray[np.int64], pixels: Array) -> Iterator[tuple[float, Array, Array]]:
    """Poses from clicks whose vertices are known: residual [px], position, rotation."""
    points = view.die.solid.vertices[vertices]
    matrix, distortion = view.camera.matrix, view.camera.distortion
    flat = np.linalg.matrix_rank(points - points.mean(0), tol=1e-3 * view.reach_m) < 3
    method = cv2.SOLVEPNP_IPPE if flat else cv2.SOLVEPNP_SQPNP
    # The planar method wants its points in their own plane's axes.
    axes = np.linalg.svd(points - points.mean(0))[2]
    axes = axes if np.linalg.det(axes) > 0 else -axes
    local = (points - points.mean(0)) @ axes.T
    local[:, 2] *= not flat
    count, turns, shifts, _ = cv2.solvePnPGeneric(local, pixels, matrix, distortion, flags=method)
    for turn, shift in zip(turns[:count], shifts[:count], strict=True):
        yield from _fitted(view, local, pixels, turn, shift, axes, points.mean(0))


def _unnamed(view: View, pixels: Array) -> Iterator[tuple[float, Array, Array]]:
    """The same for clicks whose vertices are not known; the first is given vertex 0, since a regular die looks alike
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
            names = _names(view, position, rotation, pixels)
            if names is not None:
                yield from _fitted(view, vertices[names], pixels, turn, shift, np.eye(3), np.zeros(3))


def _spread_first(pixels: Array) -> NDArray[np.int64]:
    """Order of the clicks in which the first three span the largest triangle: their pose is the surest."""

    def area(three: tuple[int, ...]) -> float:
        (ax, ay), (bx, by) = pixels[three[1]] - pixels[three[0]], pixels[three[2]] - pixels[three[0]]
        return abs(ax * by - ay * bx)

    first = max(itertools.combinations(range(len(pixels)), 3), key=area)
    return np.array([*first, *(k for k in range(len(pixels)) if k not in first)])


def _names(view: View, position: Array, rotation: Array, pixels: Array) -> NDArray[np.int64] | None:
    """The visible corner next to each click, each corner once; None where a click lies far from all that are left."""
    faces = visible_faces(view, position, rotation)
    seen = np.unique([corner for f in faces for corner in view.die.solid.faces[f]])
    if len(seen) < len(pixels):
        return None
    drawn = view.camera.project(view.die.solid.vertices[seen] @ rotation.T + position)
    if not np.isfinite(drawn).all():
        return None
    apart = np.linalg.norm(pixels[:, None] - drawn[None], axis=2)
    clicks, corners = linear_sum_assignment(np.minimum(apart, 1e4))
    # Three clicks fix the pose and the error of each is passed on to the others, with some leverage.
    return None if apart[clicks, corners].max() > 3.0 * CLICK_PX else np.asarray(seen[corners], np.int64)


def _fitted(
    view: View, points: Array, pixels: Array, turn: Array, shift: Array, axes: Array, middle: Array
) -> Iterator[tuple[float, Array, Array]]:
    """Least squares over all clicks from a first pose of points in their own axes; nothing where it ends below the table
    or behind the camera."""
    matrix, distortion = view.camera.matrix, view.camera.distortion
    turn, shift = cv2.solvePnPRefineLM(points, pixels, matrix, distortion, turn.copy(), shift.copy())
    R = np.asarray(cv2.Rodrigues(turn)[0] @ axes, float)
    position, rotation = _in_world(view, R, np.asarray(shift, float).ravel() - R @ middle)
    drawn = view.camera.project((points @ axes + middle) @ rotation.T + position)
    rms = float(np.sqrt(((drawn - pixels) ** 2).sum(1).mean()))
    # A click moves the depth by a share of the die's size; half an inscribed radius below rest is more than that.
    if np.isfinite(rms) and position[2] > 0.5 * view.die.solid.inradius:
        yield rms, position, rotation


def _in_world(view: View, rotation: Array, shift: Array) -> tuple[Array, Array]:
    """A pose in camera axes, in the world."""
    R, t = view.camera.rotation, view.camera.translation_m
    return np.asarray(R.T @ (shift - t), float), np.asarray(R.T @ rotation, float)


def _apart(view: View, poses: list[tuple[Array, Array]]) -> list[tuple[Array, Array]]:
    """The first few that draw different dice."""
    kept: list[tuple[Array, Array]] = []
    drawn: list[Array] = []
    for position, rotation in poses:
        corners = view.die.solid.vertices @ rotation.T + position
        near = APART_SHARE * view.die.solid.edge_m
        if any(np.linalg.norm(corners[:, None] - other[None], axis=2).min(1).max() < near for other in drawn):
            continue
        kept.append((position, rotation))
        drawn.append(corners)
        if len(kept) == TRIED:
            break
    return kept


def _labelled_as_given(view: View, pose: Pose, start: ManualInitialisation) -> Pose:
    """The refined pose under the labelling that was given; where none was, as it came out."""
    if start.quaternion is None:
        return pose
    turned = nearest_equivalent_rotation(pose.rotation, matrix_from_quat(start.quaternion), view.symmetries)
    return Pose(**{**vars(pose), "rotation": turned})
