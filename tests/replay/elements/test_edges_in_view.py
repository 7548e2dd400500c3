"""The visible edges of a convex solid."""

from __future__ import annotations

import numpy as np
import pytest
import replay_records as made
from scipy.spatial import ConvexHull

from diethrow.model.die.solid import SHAPES, isohedral_solid
from diethrow.model.rotations import matrix_from_quat
from diethrow.replay.elements.edges_in_view import visible_edges


@pytest.mark.parametrize("shape", SHAPES)
def test_the_silhouette_of_a_convex_solid_is_the_hull_of_its_corners(shape: str) -> None:
    """Without distortion a projection keeps straight lines, so silhouette and hull are the same polygon."""
    solid, camera = isohedral_solid(shape, 0.02), made.camera()
    straight = type(camera)(
        camera.width_px, camera.height_px, camera.matrix, np.zeros(5), camera.rotation, camera.translation_m
    )
    rng = np.random.default_rng(20)
    quaternions = rng.standard_normal((20, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    positions = np.tile([0.0, 0.0, 0.02], (20, 1))
    for drawn, quaternion in zip(visible_edges(solid, straight, positions, quaternions), quaternions, strict=True):
        corners = straight.project(solid.vertices @ matrix_from_quat(quaternion).T + positions[0])
        hull = ConvexHull(corners)
        assert len(drawn.silhouette_px) == len(hull.vertices)
        length = np.linalg.norm(drawn.silhouette_px[:, -1] - drawn.silhouette_px[:, 0], axis=1).sum()
        # Qhull calls the perimeter of a plane figure its area.
        assert length == pytest.approx(hull.area, rel=1e-9)


def test_a_cube_seen_on_a_corner_has_six_silhouette_edges_and_three_inner_ones() -> None:
    throw = made.throw()
    positions, quaternions = throw.poses([made.IMPACT_S])
    (drawn,) = visible_edges(made.die().solid, made.camera(), positions, quaternions)
    assert len(drawn.silhouette_px) == 6
    assert len(drawn.inner_px) == 3
    assert len(drawn.corners_px) == 7


def test_a_die_behind_the_camera_is_not_drawn() -> None:
    behind = made.camera().centre_m + np.array([0.0, -1.0, 0.0])
    (drawn,) = visible_edges(made.die().solid, made.camera(), behind[None], np.array([[1.0, 0.0, 0.0, 0.0]]))
    assert drawn.silhouette_px.size == drawn.inner_px.size == drawn.corners_px.size == 0
