"""What all poses of a clip get wrong alike.

Where the contour of the die is taken δ pixels too far out (a blur that is a little off, glare, the bevel of an edge), the
die seems larger, and so nearer: with an outline of area A and perimeter P, moving it out by δ enlarges it by δ P/(2 A),
and at a distance z along the line of sight d the centre seems to lie at

    p - d z δ P/(2 A).

Light from one side takes the contour further out there than on the other, and the inner edges to one side of where they
are: the whole die seems moved across the picture and turned. No frame tells these six errors from a pose, and averaging
over frames does not make them smaller. The flight does for the first: a die falls with g, in metres, and meets the table
at a height of zero. The others it leaves open, and they are part of every covariance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply
from ..camera import Camera
from ..track import Track

Array = NDArray[np.float64]

CONTOUR_SIGMA_PX = 0.05
"""One sigma of δ for a sharp die: the blur is known to a few hundredths of a pixel, and a contour with it."""
CONTOUR_FLOOR_PX = 0.008
"""What of δ neither fall nor table can tell: it is not quite the same at the top of a flight and on the table, as the light on
the faces that make the contour changes."""
CONTOUR_SHARE = 0.1
"""And of a rounded one besides, as a share of the radius: how far down its bevel an edge still looks like one."""
LATERAL_SIGMA_PX, LATERAL_SHARE = 0.01, 0.02
"""One sigma of the shift of the whole die and of its edges against each other, of a sharp die and with the radius:
opposite contours of a sharp die err by some hundredths of a pixel each, and there are several of them. A bevel of radius r
is seen some 1.4 r wide, and what shade it has between its two faces' is the light's affair: where on it an edge seems to
be varies from one edge to the next and as the die turns, and little of that is left in a flight. Where the light was
not told, nine plain dice rounded by 1 to 4 px had a median NEES of 0.7 to 5.2 where 5.35 is expected; with a share of 0.1 seven
of them had 0.1 to 1.0. Where it is (`light`) twelve have 0.2 to 2.3: half the share would do there."""
TURN_SHARE = 0.75
"""The same for the turn of the die, at its outline: several edges on either side of the axis take part in it."""
SHARED = 6
"""Contour out; die to the right and down; die turned about the camera's three axes."""


def shared_bias_jacobian(track: Track, camera: Camera, die: Die) -> Array:
    """(n, 6, SHARED) change of each frame's pose, world axes, [m] and [rad] for a pixel of each shared error.

    The track's own `lean` takes the place of the first where it has one. NaN where the frame has no pose.
    """
    lean = np.full((len(track), 6, SHARED), np.nan)
    seen = track.tracked
    sight = track.position_m[seen] - camera.centre_m
    depth = sight @ camera.rotation[2]
    growth = outline_growth(camera, die, track.position_m[seen], matrix_from_quat(track.quaternion[seen]))
    new = np.zeros((len(sight), 6, SHARED))
    new[:, :3, 0] = -sight * growth[:, None]
    new[:, :3, 1] = camera.rotation[0] * (depth / camera.matrix[0, 0])[:, None]
    new[:, :3, 2] = camera.rotation[1] * (depth / camera.matrix[1, 1])[:, None]
    new[:, 3:, 3:] = camera.rotation.T * growth[:, None, None]
    if track.lean is not None:
        own = np.isfinite(track.lean[seen]).all(1)
        new[own, :, 0] = track.lean[seen][own]
    lean[seen] = new
    return lean


def shared_bias_sigma(track: Track, camera: Camera, die: Die) -> Array:
    """(SHARED,) prior standard deviations [px] of the shared errors."""
    sight = np.linalg.norm(track.position_m[track.tracked] - camera.centre_m, axis=1)
    radius_px = die.corner_radius_m * camera.matrix[0, 0] / float(np.median(sight))
    size = np.sqrt(CONTOUR_SIGMA_PX**2 + (CONTOUR_SHARE * radius_px) ** 2 + track.contour_sigma_px**2)
    aside = np.hypot(LATERAL_SIGMA_PX, LATERAL_SHARE * radius_px)
    return np.array([size, aside, aside, *[TURN_SHARE * aside] * 3])


def without_shared_bias(track: Track, lean: Array, shared: Array) -> Track:
    """The track with shared errors (m,) of that lean (n, 6, m) taken out of its poses, to the first order."""
    change = lean @ shared
    quaternion = track.quaternion.copy()
    use = track.tracked
    quaternion[use] = quat_multiply(quat_from_rotvec(-change[use, 3:]), track.quaternion[use])
    return replace(track, position_m=track.position_m - change[:, :3], quaternion=quaternion)


def outline_growth(camera: Camera, die: Die, position_m: Array, rotation: Array) -> Array:
    """(n,) P/(2 A) [1/px] of the die's outline at each of n poses; 0 where it is behind the camera, where nothing is seen
    to lean."""
    solid = die.solid
    corners = camera.project(solid.vertices @ np.swapaxes(rotation, 1, 2) + position_m[:, None])
    toward = camera.centre_m - position_m
    facing = np.einsum("nij,fj,ni->nf", rotation, solid.normals, toward) > solid.offsets
    outline = facing[:, solid.edge_faces[:, 0]] != facing[:, solid.edge_faces[:, 1]]
    ends = corners[:, solid.edges]
    perimeter = (np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2) * outline).sum(1)
    area = np.zeros(len(corners))
    for f, face in enumerate(solid.faces):
        x, y = np.moveaxis(corners[:, list(face)], 2, 0)
        area += facing[:, f] * 0.5 * np.abs((x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(1))
    fully = np.isfinite(corners).all((1, 2)) & (area > 0.0)
    return np.asarray(np.where(fully, perimeter, 0.0) / np.where(fully, 2.0 * area, 1.0))
