"""Laws of the light on a rounded die: strips have its brightness, and pictures hand it on to each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, LIGHT, studio
from numpy.typing import NDArray
from random_throws import random_quaternion
from rounded_dice import photograph_rounded
from scipy.special import ndtr

from diethrow.model.compiled import compiled
from diethrow.model.rotations import matrix_from_quat, quat_from_matrix, rotation_between
from diethrow.model.throw import State
from diethrow.tracking.picture.view import whole_frame_windows
from diethrow.tracking.placed_die.kernel_types import LIGHT_TERMS, STRIP_CELLS, Workspace, new_equations, new_workspace
from diethrow.tracking.placed_die.rounded_edge import fill_rounded_basis, fill_strip_slopes
from diethrow.tracking.placed_die.surface_light import (
    STRIP_NODES,
    fill_strip_rows,
    keep_light,
    kept_light,
    normal_monomials,
)
from diethrow.tracking.pose.refine import pose_state, weak_prior
from diethrow.tracking.pose.refine_kernels import refine_and_score

Array = NDArray[np.float64]

STUDIO = replace(studio(), noise_grey=1.0)
ROUND = replace(DICE["cube"], corner_radius_m=1.0e-3)
SMOOTH = np.random.default_rng(1).normal(size=LIGHT_TERMS) * 20.0 + 100.0 * (np.arange(LIGHT_TERMS) == 0)
"""Coefficients of a brightness."""


@compiled
def strip(near: Array, end: Array, angle: float, interior: bool, lines: Array, work: Workspace) -> None:
    """Python cannot call a kernel that only kernels call. The strip of the brightness SMOOTH, with its lines [px]."""
    work.strip_lines[:] = lines
    fill_strip_rows(near, end, angle, interior, SMOOTH, work.light)
    fill_strip_slopes(interior, work.light.left, work)


@compiled
def basis_at(d: float, blur: float, with_blur: bool, work: Workspace) -> float:
    """What the basis functions leave at a pixel, which is number 0 of the workspace."""
    return float(fill_rounded_basis(d, blur, 1.0, with_blur, work, 0))


def workspace() -> Workspace:
    view = STUDIO.view(ROUND)
    return new_workspace(view.shape, view.rig)


def arc(angle: float) -> tuple[Array, Array, Array]:
    """A normal, the direction that it turns to, and the normals along the turn (n, 3)."""
    near, end = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])
    at = np.linspace(0.0, angle, 2001)[:, None]
    return near, end, np.cos(at) * near + np.sin(at) * end


@pytest.mark.parametrize("interior", [False, True], ids=["contour", "between faces"])
@pytest.mark.parametrize("angle", [0.5, 1.57, 1.9])
def test_a_strip_has_the_brightness_of_its_normals(angle: float, interior: bool) -> None:
    """Its intensities and what they leave, blurred, are the blurred brightness of the turning surface."""
    work, blur, radius = workspace(), 0.7, 6.0
    near, end, normals = arc(angle)
    # Seen along the line that the normal reaches at the end of a strip at the contour, or in the middle of one between faces.
    turned = np.linspace(0.0, angle, 2001)
    tilt = 0.5 * np.pi - angle if not interior else -0.5 * angle
    place = radius * np.sin(tilt + turned)
    nodes = radius * np.sin(tilt + angle * np.arange(STRIP_CELLS + 1) / STRIP_CELLS)
    strip(near, end, angle, interior, nodes, work)
    c = work.light.rows @ SMOOTH
    c[1] = c[1] if interior else 40.0
    brightness = normal_monomials(normals) @ SMOOTH
    fine = np.linspace(place[0] - 20.0, place[-1] + 20.0, 40001)
    profile = np.interp(fine, place, brightness, left=brightness[0], right=c[1])
    steps = np.diff(profile)
    edges = 0.5 * (fine[1:] + fine[:-1])
    for d in np.arange(place[0] - 3.0, place[-1] + 3.0, 0.37):
        seen = profile[0] + steps @ ndtr((d - edges) / blur)
        left = basis_at(d, blur, False, work)
        assert left + c @ work.basis[:, 0] == pytest.approx(seen, abs=0.03 * np.ptp(profile))


@pytest.mark.parametrize("interior", [False, True], ids=["contour", "between faces"])
def test_slopes_of_a_strip_are_its_derivatives(interior: bool) -> None:
    work, (near, end, _) = workspace(), arc(1.2)
    strip(near, end, 1.2, interior, np.array([-2.0, -1.3, -0.2, 0.9, 1.8, 2.0]), work)
    for d in (-3.0, -1.0, 0.3, 1.6, 2.5):
        h = 0.01
        ahead, behind = values(d + h, 0.7, work), values(d - h, 0.7, work)
        wider, narrower = values(d, 0.7 + h, work), values(d, 0.7 - h, work)
        basis_at(d, 0.7, True, work)
        slopes = [*work.basis_slope[:, 0], work.known_slope[0]]
        assert slopes == pytest.approx((ahead - behind) / (2 * h), rel=2e-3, abs=5e-3)
        assert work.basis_blur[:, 0] == pytest.approx((wider - narrower)[:4] / (2 * h), rel=2e-3, abs=5e-3)


def values(d: float, blur: float, work: Workspace) -> Array:
    """(5,) basis functions and what they leave."""
    left = basis_at(d, blur, False, work)
    return np.array([*work.basis[:, 0], left])


def test_nodes_of_a_strip_have_the_mean_of_the_curve() -> None:
    u = np.linspace(0.0, 1.0, 10001)
    chords = np.interp(u, np.arange(STRIP_CELLS + 1) / STRIP_CELLS, STRIP_NODES[1, :, 2])
    middle = (u > 1.0 / STRIP_CELLS) & (u < 1.0 - 1.0 / STRIP_CELLS)
    assert (chords - 4.0 * u * (1.0 - u))[middle].mean() == pytest.approx(0.0, abs=2e-3)


def shown(count: int, seed: int) -> list[tuple[State, NDArray[np.float32]]]:
    """Random orientations in the middle of the picture, and their pictures."""
    rng, none, found = np.random.default_rng(seed), np.zeros(3), []
    for k in range(count):
        at = np.array([*rng.uniform(-2e-3, 2e-3, 2), 0.018])
        state = State(0.0, at, random_quaternion(rng), none, none)
        found.append((state, photograph_rounded(STUDIO, ROUND, state, np.random.default_rng([seed, k]))))
    return found


def test_light_kept_from_earlier_pictures_reduces_errors_and_stated_errors() -> None:
    """With the light of 20 pictures the later ones are sure of the distance as single pictures are not."""
    view = STUDIO.view(ROUND)
    settings = view.settings._replace(fine_steps=12, min_gain=1e-4)
    errors: dict[bool, list[float]] = {False: [], True: []}
    sigmas: dict[bool, list[float]] = {False: [], True: []}
    for keep in (False, True):
        work, equations = new_workspace(view.shape, view.rig), new_equations()
        for k, (state, image) in enumerate(shown(40, 3)):
            start = pose_state(state.position_m, matrix_from_quat(state.quaternion))
            p, R, _ = refine_and_score(
                whole_frame_windows(view, image), view.model(settings), start, weak_prior(view, start.position), 0,
                work, equations,
            )  # fmt: skip
            if keep:
                keep_light(work.light, equations.H[:6, :6].copy())
            if k >= 20:
                along = (p - state.position_m) @ STUDIO.camera.rotation[2]
                turned = rotation_between(state.quaternion, quat_from_matrix(R))
                covariance = np.linalg.inv(equations.H[:6, :6])[:3, :3]
                errors[keep].append(float(np.hypot(along / 1e-4, np.linalg.norm(turned) / 1e-3)))
                sigmas[keep].append(float(np.sqrt(STUDIO.camera.rotation[2] @ covariance @ STUDIO.camera.rotation[2])))
    assert np.median(errors[True]) < 0.9 * np.median(errors[False])
    assert np.median(sigmas[True]) < 0.95 * np.median(sigmas[False])


def test_light_is_that_of_the_lamp() -> None:
    """The brightness that 20 pictures leave agrees with the lamp's within what they leave open."""
    view = STUDIO.view(ROUND)
    work, equations = new_workspace(view.shape, view.rig), new_equations()
    settings = view.settings._replace(fine_steps=12, min_gain=1e-4)
    for state, image in shown(20, 4):
        start = pose_state(state.position_m, matrix_from_quat(state.quaternion))
        refine_and_score(
            whole_frame_windows(view, image), view.model(settings), start, weak_prior(view, start.position), 0, work,
            equations,
        )  # fmt: skip
        keep_light(work.light, equations.H[:6, :6].copy())
    normals = np.random.default_rng(3).normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    normals = normals[normals @ STUDIO.camera.rotation[2] < -0.2]
    true = 115.0 + 90.0 * np.maximum(normals @ LIGHT, 0.0)
    _, mean, information = kept_light(work)
    rows = normal_monomials(normals)
    scale = (rows @ mean[0]) @ true / (true @ true)
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", rows, np.linalg.inv(information[0]), rows))
    deviation = np.hypot(sigma, work.light.deviation[0])
    assert np.mean(np.abs(rows @ mean[0] - scale * true) < 2.0 * deviation) > 0.9


def test_a_sharp_die_has_no_light() -> None:
    view = STUDIO.view(DICE["cube"])
    assert new_workspace(view.shape, view.rig).light.level.shape == (0,)
