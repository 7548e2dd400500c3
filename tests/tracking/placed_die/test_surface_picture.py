"""Laws of the predicted picture of a rounded die: it is what a camera sees of one, and its derivatives are those of finite
steps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from footage_of_throws import DICE, studio
from numpy.typing import NDArray
from random_throws import random_quaternion
from rounded_dice import photograph_rounded

from diethrow.model.compiled import compiled
from diethrow.model.rotations import matrix_from_quat, quat_from_rotvec
from diethrow.model.throw import State
from diethrow.tracking.picture import View, add_picture_equations, with_corner_radius
from diethrow.tracking.picture.view import whole_frame_windows
from diethrow.tracking.placed_die import (
    LIGHT_TERMS,
    EdgeSampling,
    FrameWindows,
    PictureModel,
    PoseState,
    Workspace,
    begin_light,
    new_equations,
    new_workspace,
    place_die,
    update_light,
)
from diethrow.tracking.placed_die.surface_grid import blur_of_pixels, fill_blurred_row, new_surface_grid
from diethrow.tracking.placed_die.surface_picture import draw_surface, fill_changes
from diethrow.tracking.pose import pose_state

Array = NDArray[np.float64]

HALF_PX = 60
"""Half-width of the box that is drawn."""
ROUNDS = 8
"""Steps in which the light of a picture is solved for."""


class Drawn(NamedTuple):
    """A predicted picture."""

    grey: Array
    """(rows, columns)"""
    jacobian: Array
    """(rows, columns, 6) its derivatives by the pose."""
    share: Array
    """(rows, columns) of the die behind each pixel."""


@compiled
def solve_light(
    windows: FrameWindows, model: PictureModel, pose: PoseState, sampling: EdgeSampling, work: Workspace
) -> None:
    """Python cannot call a kernel that only kernels call. The light and the deviations that explain a picture at a pose."""
    begin_light(model.settings.light, work.light)
    equations, still = new_equations(), np.zeros(6)
    for _ in range(ROUNDS):
        equations.H[:] = 0.0
        equations.g[:] = 0.0
        add_picture_equations(np.int64(0), windows, model, pose, sampling, work, equations)
        update_light(work.light, still)


@compiled
def draw(model: PictureModel, pose: PoseState, sampling: EdgeSampling, work: Workspace, box: Any, out: Drawn) -> None:
    view, background = np.int64(0), model.backgrounds[0]
    place_die(model.shape, model.rig, view, pose, work)
    grid = new_surface_grid(box)
    fill_changes(view, model, pose, sampling, background, work, grid)
    draw_surface(view, model, pose, sampling, work, grid)
    blur = blur_of_pixels(view, model, pose, sampling.blur_px)
    slope, parts, shares = np.zeros(3 + LIGHT_TERMS), np.zeros(8, np.int64), np.zeros(8)
    for i in range(out.grey.shape[0]):
        for j in range(out.grey.shape[1]):
            under = background[box[1] + i, box[0] + j]
            out.grey[i, j] = grid.glow[i, j] + (1.0 - grid.share[i, j]) * under
            out.share[i, j] = grid.share[i, j]
            gx = grid.gradient[i, j, 0] - under * grid.gradient[i, j, 2]
            gy = grid.gradient[i, j, 1] - under * grid.gradient[i, j, 3]
            fill_blurred_row(grid, i, j, blur, slope, parts, shares)
            for a in range(6):
                out.jacobian[i, j, a] = -gx * grid.flow[i, j, 0, a] - gy * grid.flow[i, j, 1, a]
            for a in range(3):
                out.jacobian[i, j, 3 + a] += slope[a]


class Scene(NamedTuple):
    """A rounded die before a camera, with its light."""

    view: View
    pose: PoseState
    image: NDArray[np.float32]
    work: Workspace

    @property
    def box(self) -> tuple[Any, Any, Any, Any]:
        """Pixels about the die."""
        x, y = (np.int64(v) for v in self.view.camera.project(self.pose.position[None])[0])
        return x - HALF_PX, y - HALF_PX, x + HALF_PX, y + HALF_PX

    def drawn(self, pose: PoseState) -> Drawn:
        """The picture that another pose predicts."""
        size = (2 * HALF_PX, 2 * HALF_PX)
        out = Drawn(np.zeros(size), np.zeros((*size, 6)), np.zeros(size))
        draw(self.view.model(self.view.settings), pose, self.sampling, self.work, self.box, out)
        return out

    @property
    def sampling(self) -> EdgeSampling:
        """At the lens blur."""
        return EdgeSampling(self.view.blur_px, max(4.0 * self.view.blur_px, 3.5), False, False)


def scene(radius_m: float, seed: int) -> Scene:
    """A cube with corners of a radius in any orientation."""
    setting, die = replace(studio(), noise_grey=0.0), replace(DICE["cube"], corner_radius_m=radius_m)
    state = State(
        0.0, np.array([0.001, -0.002, 0.02]), random_quaternion(np.random.default_rng(seed)), np.zeros(3), np.zeros(3)
    )
    image, view = photograph_rounded(setting, die, state), replace(setting.view(die), noise_grey=0.5)
    made = Scene(view, pose_state(state.position_m, state.rotation), image, new_workspace(view.shape, view.rig))
    model = view.model(view.settings)
    solve_light(whole_frame_windows(view, image), model, made.pose, made.sampling, made.work)
    return made


RADII_M = (0.6e-3, 1.6e-3, 3.0e-3)


@pytest.mark.parametrize("radius_m", RADII_M)
def test_a_picture_is_what_a_camera_sees(radius_m: float) -> None:
    """Ray marching shares no code with the drawing. The light has a terminator, which a polynomial smooths."""
    for seed in range(6):
        made = scene(radius_m, seed)
        x0, y0, x1, y1 = made.box
        drawn, seen = made.drawn(made.pose), made.image[y0:y1, x0:x1]
        contrast = float(np.ptp(seen))
        assert np.sqrt(np.mean((drawn.grey - seen) ** 2)) < 0.005 * contrast
        assert np.abs(drawn.grey - seen).max() < 0.06 * contrast
        # A contour that lay 0.05 px too far out would change the area by ten times that.
        at_contour = np.where((drawn.share > 0.02) & (drawn.share < 0.98), drawn.grey - seen, 0.0)
        assert abs(at_contour.sum()) < 0.01 * contrast * np.count_nonzero(at_contour)


@pytest.mark.parametrize("column", range(6))
@pytest.mark.parametrize("radius_m", RADII_M[:2])
def test_derivatives_are_those_of_finite_steps(radius_m: float, column: int) -> None:
    """To a fifth for displacements and a third for rotations: the motion of a bevel and the turn of its normal cancel."""
    made = scene(radius_m, 7)
    step = np.zeros(6)
    step[column] = 2e-5 if column < 3 else 2e-3
    p, R = made.pose.position, made.pose.rotation
    ahead, back = (
        made.drawn(pose_state(p + s * step[:3], matrix_from_quat(quat_from_rotvec(s * step[None, 3:]))[0] @ R)).grey
        for s in (1.0, -1.0)
    )
    expected = (ahead - back) / (2.0 * step[column])
    found = made.drawn(made.pose).jacobian[..., column]
    assert np.linalg.norm(found - expected) < (0.2 if column < 3 else 0.35) * np.linalg.norm(expected)
    assert float((found * expected).sum() / (expected * expected).sum()) == pytest.approx(1.0, abs=0.12)


def test_the_share_of_a_die_is_its_area() -> None:
    """The outline of the inner body moved out by a ball has the area A + P r + π r²: Steiner's formula."""
    for seed in range(6):
        view = with_corner_radius(studio().view(DICE["octahedron"]), 0.25 * DICE["octahedron"].solid.inradius)
        pose = pose_state(np.array([0.0, 0.0, 0.02]), matrix_from_quat(random_quaternion(np.random.default_rng(seed))))
        made = Scene(view, pose, np.zeros((1, 1), np.float32), new_workspace(view.shape, view.rig))
        px = view.camera.project(view.shape.vertices @ pose.rotation.T + pose.position)
        depth = float((pose.position - view.camera.centre_m) @ view.camera.rotation[2])
        ball = view.shape.radius * view.camera.matrix[0, 0] / depth
        hull = outline(px)
        ring = np.roll(hull, -1, axis=0) - hull
        area = 0.5 * abs(float(np.sum(hull[:, 0] * np.roll(hull[:, 1], -1) - hull[:, 1] * np.roll(hull[:, 0], -1))))
        expected = area + float(np.linalg.norm(ring, axis=1).sum()) * ball + np.pi * ball * ball
        assert made.drawn(pose).share.sum() == pytest.approx(expected, rel=0.01)


def test_a_moving_die_is_the_mean_of_still_ones() -> None:
    """Over an exposure in which it moves by five pixels and turns by twenty degrees."""
    made, exposure_s = scene(1.6e-3, 3), 1e-3
    moving = made.pose._replace(velocity=np.array([0.5, -0.4, 0.6]), omega=np.array([150.0, 250.0, -180.0]))
    exposed = made._replace(view=replace(made.view, exposure_s=exposure_s))
    grey, times_s = exposed.drawn(moving).grey, (np.arange(64) + 0.5) / 64.0 * exposure_s - 0.5 * exposure_s
    turns = matrix_from_quat(quat_from_rotvec(np.outer(times_s, moving.omega)))
    still = [
        made.drawn(pose_state(moving.position + t * moving.velocity, turn @ moving.rotation)).grey
        for t, turn in zip(times_s, turns, strict=True)
    ]
    expected = np.mean(still, axis=0)
    assert np.abs(expected - still[32]).max() > 30.0
    assert np.sqrt(np.mean((grey - expected) ** 2)) < 0.01 * np.ptp(expected)


def test_a_coarse_picture_is_blurred_as_a_fine_one() -> None:
    """Along rows and then along columns, and at once where the lens blurs as much."""
    made, blur_px = scene(1.6e-3, 5), 1.5
    sampling = EdgeSampling(blur_px, 6.0, False, False)
    coarse, fine = (
        Drawn(np.zeros((2 * HALF_PX,) * 2), np.zeros((2 * HALF_PX, 2 * HALF_PX, 6)), np.zeros((2 * HALF_PX,) * 2))
        for _ in range(2)
    )
    for view, out in ((made.view, coarse), (replace(made.view, blur_px=blur_px), fine)):
        draw(view.model(view.settings), made.pose, sampling, made.work, made.box, out)
    contrast = float(np.ptp(fine.grey))
    assert 0.0 < np.abs(coarse.grey - fine.grey).max() < 0.01 * contrast
    assert np.linalg.norm(coarse.jacobian - fine.jacobian) < 0.02 * np.linalg.norm(fine.jacobian)


def outline(px: Array) -> Array:
    """(k, 2) corners of the convex hull in order."""
    return np.asarray(cv2.convexHull(px.astype(np.float32))[:, 0], float)
