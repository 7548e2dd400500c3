"""Pose errors that all frames of a clip share.

If the contour of the die is taken δ pixels too far out (wrong blur, glare, bevelled edges), the die seems larger and therefore
nearer. An outline of area A and perimeter P that moves out by δ grows by the factor 1 + δ P/(2 A). At a distance z along the line
of sight d the centre then seems to lie at

    p - d z δ P/(2 A).

Light from one side moves the contour out further on that side, and moves interior edges as well. The die then seems shifted
across the picture and rotated. A single frame cannot distinguish these six errors from a pose, and averaging over frames does not
reduce them. The flight determines the first: a die falls with g in metres, and touches the table at height zero. The other five
remain undetermined and enter every covariance.

If the response of the camera is not known, there is a seventh: blur mixes light and not grey levels, so that a curve moves every
edge towards its darker side. What that does to a pose changes as the die turns, and the flights determine the exponent with the
first.

The columns of a bias Jacobian are, in this order: contour out; exponent of the response, if it is not known; die right and
down; die rotated about the camera's three axes. Those before the last five are estimated with the flights.
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

UNDETERMINED = 5
"""Number of shared errors that flights do not determine: two of translation, three of rotation."""
CONTOUR_SIGMA_PX = 0.05
"""Prior standard deviation [px] of δ for a sharp die: the blur, and with it the contour, is known to a few hundredths of a
pixel."""
CONTOUR_UNDETERMINED_PX = 0.008
"""Standard deviation [px] of the part of δ that neither fall nor table determines: δ at the top of a flight differs from δ at the
table, because the light on the faces that form the contour changes."""
CONTOUR_UNDETERMINED_SHARE = 0.015
"""Additional standard deviation of that part for a rounded die, as a share of the radius: root mean square between the flights
of 23 random clips, of whole surfaces refined from the true poses. The median is half of it, the largest, of a
tetrahedron, 0.035."""
CONTOUR_SHARE = 0.1
"""Additional prior standard deviation of δ for a rounded die, as a share of the radius: how far down its bevel the contour
appears."""
LATERAL_SIGMA_PX = 0.01
"""Prior standard deviation [px] of the shift of a sharp die across the picture: opposite contours err by some hundredths of a
pixel each, and there are several of them."""
LATERAL_SHARE = 0.02
"""Additional lateral standard deviation of a rounded die, as a share of the radius r.

A bevel is seen about 1.4 r wide, and the light determines where on it an edge appears. That varies between edges and as the die
rotates, so that little of it remains in a flight. With the light unknown, nine plain dice rounded by 1 to 4 px had a median NEES
of 0.7 to 5.2 (expected: 5.35); with a share of 0.1 seven of them had 0.1 to 1.0. With the light estimated (`light`), twelve dice
have 0.2 to 2.3: half the share would suffice there."""
RESPONSE_UNDETERMINED = 0.03
"""Standard deviation of the part of the exponent of a response that flights do not determine: curves of cameras are no powers."""
LEAST_SHOWN = 1e-9
"""Least sum of the cosines at which a face is seen: one that no frame shows has no marks."""
ROTATION_SHARE = 0.75
"""Rotation error at the outline over lateral error: several edges on both sides of the axis contribute to a rotation."""


def shared_bias_jacobian(track: Track, camera: Camera, die: Die) -> Array:
    """(n, 6, m) change of each frame's pose [m, rad], world axes, by each shared error [px, or exponent].

    The first columns are the track's `bias_jacobian` where it has one. Rows without a pose are NaN.
    """
    tracked, k = track.tracked, determined_count(track)
    jacobian = np.full((len(track), 6, k + UNDETERMINED), np.nan)
    sight = track.position_m[tracked] - camera.centre_m
    depth = sight @ camera.rotation[2]
    growth = outline_growth(camera, die, track.position_m[tracked], matrix_from_quat(track.quaternion[tracked]))
    new = np.zeros((len(sight), 6, k + UNDETERMINED))
    new[:, :3, 0] = -sight * growth[:, None]
    new[:, :3, k] = camera.rotation[0] * (depth / camera.matrix[0, 0])[:, None]
    new[:, :3, k + 1] = camera.rotation[1] * (depth / camera.matrix[1, 1])[:, None]
    new[:, 3:, k + 2 :] = camera.rotation.T * growth[:, None, None]
    if track.bias_jacobian is not None:
        measured = np.isfinite(track.bias_jacobian[tracked]).all(axis=(1, 2))
        new[measured, :, :k] = track.bias_jacobian[tracked][measured]
    jacobian[tracked] = new
    return jacobian


def determined_count(track: Track) -> int:
    """Number of shared errors that flights determine: that of the contour, and that of a response that is not known."""
    return 1 if track.bias_jacobian is None else int(track.bias_jacobian.shape[2])


def shared_bias_sigma(track: Track, camera: Camera, die: Die) -> Array:
    """(m,) prior standard deviations [px, or exponent] of the shared errors."""
    radius_px = _radius_px(track, camera, die)
    contour = np.sqrt(CONTOUR_SIGMA_PX**2 + (CONTOUR_SHARE * radius_px) ** 2 + track.contour_sigma_px**2)
    lateral = np.hypot(LATERAL_SIGMA_PX, LATERAL_SHARE * radius_px)
    response = [track.response_sigma] * (determined_count(track) - 1)
    return np.array([contour, *response, lateral, lateral, *[ROTATION_SHARE * lateral] * 3])


def undetermined_bias_sigma(track: Track, camera: Camera, die: Die) -> Array:
    """(m,) standard deviations [px, or exponent] of the part of the shared errors that a throw in flight does not determine."""
    contour = np.hypot(CONTOUR_UNDETERMINED_PX, CONTOUR_UNDETERMINED_SHARE * _radius_px(track, camera, die))
    response = [min(RESPONSE_UNDETERMINED, track.response_sigma)] * (determined_count(track) - 1)
    return np.array([contour, *response, *shared_bias_sigma(track, camera, die)[-UNDETERMINED:]])


def placement_covariances(track: Track, camera: Camera, die: Die, learned: NDArray[np.int64]) -> Array:
    """(n, 6, 6) covariance that poses on surface marks share because edges located the marks; NaN without a pose.

    The bias of the edges has fixed axes before the camera, and the marks turn with the die: the place of a face's marks in body
    axes has the mean of that bias over the rows `learned` that show the face, and a pose has that of the faces in view, as the
    die lies then. Little is left after a whole turn. A bias along the line of sight only scales the marks, and the flights
    determine it."""
    bias, sigma = shared_bias_jacobian(track, camera, die), undetermined_bias_sigma(track, camera, die)
    sight = track.position_m - camera.centre_m
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    bias[:, :3] -= sight[:, :, None] * np.einsum("ni,nij->nj", sight, bias[:, :3])[:, None]
    covariance, use = np.full((len(track), 6, 6), np.nan), np.flatnonzero(track.tracked)
    body = np.zeros((len(track), 6, 6))
    body[use, :3, :3] = body[use, 3:, 3:] = matrix_from_quat(track.quaternion[use])
    toward = np.einsum("nij,ni->nj", body[use, :3, :3], -sight[use])
    shown = np.zeros((len(track), len(die.solid.normals)))
    shown[use] = np.maximum(toward @ die.solid.normals.T, 0.0)
    of_face = np.einsum("nf,nij->fij", shown[learned], np.swapaxes(body[learned], 1, 2) @ bias[learned])
    of_face /= np.maximum(shown[learned].sum(axis=0), LEAST_SHOWN)[:, None, None]
    share = shown[use] / shown[use].sum(axis=1, keepdims=True)
    moved = body[use] @ (np.einsum("nf,fij->nij", share, of_face) * sigma)
    covariance[use] = moved @ np.swapaxes(moved, 1, 2)
    return covariance


def _radius_px(track: Track, camera: Camera, die: Die) -> float:
    """Radius of the die's corners in the picture [px]."""
    sight = np.linalg.norm(track.position_m[track.tracked] - camera.centre_m, axis=1)
    return float(die.corner_radius_m * camera.matrix[0, 0] / np.median(sight))


def without_shared_bias(track: Track, jacobian: Array, shared: Array) -> Track:
    """The track with shared errors (m,) [px] subtracted from its poses, to first order in `jacobian` (n, 6, m)."""
    change = jacobian @ shared
    quaternion = track.quaternion.copy()
    use = track.tracked
    quaternion[use] = quat_multiply(quat_from_rotvec(-change[use, 3:]), track.quaternion[use])
    return replace(track, position_m=track.position_m - change[:, :3], quaternion=quaternion)


def outline_growth(camera: Camera, die: Die, position_m: Array, rotation: Array) -> Array:
    """(n,) P/(2 A) [1/px] of the die's outline at n poses; 0 where the die is behind the camera and has no outline."""
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
