"""The depth reversal of a pose: the one that draws nearly the same outline with near and far exchanged.

The vertices of a die, reflected through its centre, are those of the die rotated by some T (the identity, except for the
tetrahedron). The depth reversal of an orientation R, seen along u, is a half turn about u of R T."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...model.die import inversion_rotation
from ..picture import Image, View
from .candidate_poses import same_picture
from .refine import Pose, pose_state, refine_pose

Array = NDArray[np.float64]


def half_turn_about_sight(view: View, position_m: Array) -> Array:
    """(3, 3) half turn about the line of sight of the first camera to a place (3,)."""
    along = (position_m - view.camera.centre_m) / np.linalg.norm(position_m - view.camera.centre_m)
    return np.asarray(2.0 * np.outer(along, along) - np.eye(3))


def reversed_in_depth(view: View, position_m: Array, rotation: Array) -> Array | None:
    """The orientation (3, 3) that draws nearly the same outline with near and far exchanged, along the line of sight of the first
    camera; None for a solid that has none."""
    inversion = inversion_rotation(view.die.solid)
    if inversion is None:
        return None
    return np.asarray(half_turn_about_sight(view, position_m) @ rotation @ inversion)


def reversed_pose(view: View, picture: Image, position_m: Array, rotation: Array) -> Pose | None:
    """The depth reversal of a pose as it explains a picture best; None if there is none, the picture leaves it open, or it draws
    the same die."""
    reversal = reversed_in_depth(view, position_m, rotation)
    if reversal is None:
        return None
    pose = refine_pose(view, picture, pose_state(position_m, reversal), coarse=2, roughly=True)
    if pose.covariance is None or same_picture(view, (position_m, rotation), (pose.position_m, pose.rotation)):
        return None
    return pose
