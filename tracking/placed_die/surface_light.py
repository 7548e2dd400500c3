"""The light on a die: how bright its surface looks by its normal, as an unknown that all edges of a picture share.

A die is convex, so that no part of it shades another. With distant light, a distant camera and one paint the brightness
B of a point depends on its normal n alone, dull or glossy: B(n) = Σ_k ℓ_k m_k(n), with the monomials m of degree 4 in n
on the sphere. The light that a dull surface reflects is to 99 % of the second degree, whatever its source (Ramamoorthi
and Hanrahan, J. Opt. Soc. Am. A 18, 2448, 2001). The prior on ℓ is that of lamps in unknown directions.

The strip between a flat face and the contour of a rounded die holds few pixels, in which its shade and the position of
the contour can hardly be distinguished. Two things determine the shade: the flat faces, and the other strips. So the
intensities c of a stretch of edge (`rounded_edge`) are c = T ℓ + δ, with the rows T of B and of its course over the
strip, and deviations δ of a few percent for what B does not describe: highlights, grain, a near lamp. The deviations of
all stretches of one edge are the same, because they see the same normals; one of n such stretches gets n times the
variance. Large deviations have heavy tails (Student's t), for a highlight is far from any polynomial.

The coefficients ℓ are eliminated from the equations of a view like the intensities (`edge_stretch`). What a picture
determines of them is the prior for the next picture of the same die.
"""

from __future__ import annotations

from math import cos, sin
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...model.compiled import compiled, inner_no_memory
from .kernel_types import CONTOUR, LIGHT_DEGREE, LIGHT_TERMS, PARAMETERS, STRIP_CELLS, LightSpace, Workspace
from .small_matrices import cholesky_factor, solve_factored

Array = NDArray[np.float64]

DEVIATION_SHARE = 0.05
"""Standard deviation of intensities from B, in units of the mean brightness, before a clip has shown it."""
FACE_EDGES = 4.0
"""Edges of a face, whose stretches all see the deviation of the same face."""
TAIL_DEGREES = 4.0
"""Degrees of freedom of Student's t for the deviations of strips."""
MEMORY = 0.95
"""Factor on the information about the light from one picture to the next: it is that of the last 20 pictures. The light
on a die changes as it falls, if the lamps are near."""
LEAST_LIGHT_PIVOT = 1e-12
"""Part of its diagonal that a pivot of the equations of the light keeps at the least."""
PRIOR_SIGMAS = np.array([10.0, 2.0, 1.25, 0.5, 0.4])
"""Prior standard deviation of each degree's part of the brightness, in units of its mean. A lamp on a dull surface
gives 1, 2, 1.25, 0 and -0.375 times the Legendre polynomials in the cosine of the angle to it; the overall brightness
is unknown."""
NO_LIGHT = -1.0
"""Level of a light that strips do not follow."""
SPHERE_POINTS = 200
"""Normals over which the prior is computed."""
CONTOUR_WEIGHT_DROP = 0.8
"""Weights of the course of B along a strip at the contour fall linearly to one less this: the surface turns away there,
and shows few pixels."""


class LightPrior(NamedTuple):
    """What is known of the light before a picture is looked at, for each view."""

    level: Any
    """(views,) [grey] mean brightness; 0 if nothing is known, NO_LIGHT if strips shall have any shade."""
    mean: Any
    """(views, LIGHT_TERMS) [grey] coefficients."""
    information: Any
    """(views, LIGHT_TERMS, LIGHT_TERMS) [1/grey²] inverse covariance of these."""
    deviation: Any
    """(views,) [grey] standard deviation of intensities from B."""


def unknown_light(views: int) -> LightPrior:
    """Nothing is known."""
    return LightPrior(
        np.zeros(views), np.zeros((views, LIGHT_TERMS)), np.zeros((views, LIGHT_TERMS, LIGHT_TERMS)), np.zeros(views)
    )


def strips_of_any_shade(views: int) -> LightPrior:
    """No light: the shades of strips are free, but for a weak prior."""
    return unknown_light(views)._replace(level=np.full(views, NO_LIGHT))


# --- monomials and prior


_POWERS = [
    (i, j, k)
    for i in range(LIGHT_DEGREE + 1)
    for j in range(LIGHT_DEGREE + 1 - i)
    for k in range(2 if i + j < LIGHT_DEGREE else 1)
]


def normal_monomials(normals: Array) -> Array:
    """(n, LIGHT_TERMS) the products xⁱ yʲ zᵏ of normals (n, 3), in the order of `fill_monomials`: k is at most 1,
    since z² is 1 - x² - y²."""
    x, y, z = normals.T
    return np.stack([x**i * y**j * z**k for i, j, k in _POWERS], axis=1)


@inner_no_memory
def fill_monomials(x: float, y: float, z: float, out: Any) -> None:
    """Fill the monomials (LIGHT_TERMS,) of a normal; the first is 1."""
    k, a = np.int64(0), 1.0
    for i in range(LIGHT_DEGREE + 1):
        b = a
        for j in range(LIGHT_DEGREE + 1 - i):
            out[k] = b
            k += 1
            if i + j < LIGHT_DEGREE:
                out[k] = b * z
                k += 1
            b *= y
        a *= x


def _spiral_on_sphere(count: int) -> Array:
    """(count, 3) unit vectors, evenly spread on a golden spiral."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z * z)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


SPHERE = _spiral_on_sphere(SPHERE_POINTS)


def _lamp_prior() -> Array:
    """(LIGHT_TERMS, LIGHT_TERMS) prior information on the coefficients of a mean brightness of 1, for lamps in unknown
    directions. By the addition theorem the covariance of the brightness at normals n and n' is
    Σ σ_l² P_l(n · n')/(2 l + 1)."""
    by_degree = PRIOR_SIGMAS**2 / (2.0 * np.arange(LIGHT_DEGREE + 1) + 1.0)
    covariance = np.polynomial.legendre.legval(SPHERE @ SPHERE.T, by_degree)
    fit = np.linalg.pinv(normal_monomials(SPHERE))
    return np.asarray(np.linalg.inv(fit @ covariance @ fit.T))


LAMP_PRIOR = np.ascontiguousarray(_lamp_prior())


def _strip_nodes() -> Array:
    """(2, STRIP_CELLS + 1, 4) the basis functions of `rounded_edge` at the nodes of a strip: at the contour, and between
    two faces. They have the mean of the curves when joined by chords."""
    u = np.arange(STRIP_CELLS + 1) / STRIP_CELLS
    flat, none = np.ones_like(u), np.zeros_like(u)
    humps = 4.0 * u * (1.0 - u), 6.0 * np.sqrt(3.0) * u * (1.0 - u) * (1.0 - 2.0 * u)
    nodes = np.stack([np.stack([flat, none, u, u * u], axis=1), np.stack([1.0 - u, u, *humps], axis=1)])
    nodes[:, 1:-1] -= np.diff(nodes, 2, axis=1) / 12.0
    return nodes


def _strip_projection() -> Array:
    """(2, 2, STRIP_CELLS + 1) what the course of B over the nodes of a strip adds to its last two intensities, by least
    squares: at the contour, and between two faces."""
    u = np.arange(STRIP_CELLS + 1) / STRIP_CELLS
    weight = np.stack([1.0 - CONTOUR_WEIGHT_DROP * u, np.ones_like(u)])
    return np.stack([np.linalg.pinv(n[:, 2:] * w[:, None]) * w for n, w in zip(STRIP_NODES, weight, strict=True)])


STRIP_NODES = np.ascontiguousarray(_strip_nodes())
_PROJECTION = np.ascontiguousarray(_strip_projection())


# --- one stretch of edge


@inner_no_memory
def fill_strip_rows(n0: Any, end: Any, angle: float, interior: bool, mean: Any, light: LightSpace) -> None:
    """Fill `light.rows` (4, LIGHT_TERMS), T: the intensities of a strip by the coefficients of the light; and
    `light.left` (STRIP_CELLS + 1,), what T leaves of the brightness by the coefficients `mean`, at the nodes.

    The normal turns from n0 towards `end` by `angle` [rad]."""
    rows, here, course, left = light.rows, light.monomials, light.course, light.left
    kind = 1 if interior else 0
    fill_monomials(n0[0], n0[1], n0[2], rows[0])
    c, s = cos(angle), sin(angle)
    fill_monomials(c * n0[0] + s * end[0], c * n0[1] + s * end[1], c * n0[2] + s * end[2], rows[1])
    near_grey, far_grey = _inner(rows[0], mean), _inner(rows[1], mean)
    far_share = 1.0 if interior else 0.0
    for k in range(LIGHT_TERMS):
        beyond = 0.0 if interior else rows[1, k] - rows[0, k]
        rows[2, k] = _PROJECTION[kind, 0, STRIP_CELLS] * beyond
        rows[3, k] = _PROJECTION[kind, 1, STRIP_CELLS] * beyond
    course[0] = 0.0
    course[STRIP_CELLS] = 0.0 if interior else far_grey - near_grey
    for j in range(1, STRIP_CELLS):
        u = j / STRIP_CELLS
        c, s = cos(u * angle), sin(u * angle)
        fill_monomials(c * n0[0] + s * end[0], c * n0[1] + s * end[1], c * n0[2] + s * end[2], here)
        near, far = 1.0 - far_share * u, far_share * u
        first, second = _PROJECTION[kind, 0, j], _PROJECTION[kind, 1, j]
        for k in range(LIGHT_TERMS):
            beyond = here[k] - near * rows[0, k] - far * rows[1, k]
            rows[2, k] += first * beyond
            rows[3, k] += second * beyond
        course[j] = _inner(here, mean) - near * near_grey - far * far_grey
    if not interior:
        for k in range(LIGHT_TERMS):
            rows[1, k] = 0.0
    first, second = _inner(rows[2], mean), _inner(rows[3], mean)
    for j in range(STRIP_CELLS + 1):
        left[j] = course[j] - first * STRIP_NODES[kind, j, 2] - second * STRIP_NODES[kind, j, 3]
        if 0 < j < STRIP_CELLS:
            left[j] -= (course[j + 1] - 2.0 * course[j] + course[j - 1]) / 12.0


@inner_no_memory
def _inner(row: Any, mean: Any) -> float:
    total = 0.0
    for k in range(LIGHT_TERMS):
        total += row[k] * mean[k]
    return total


@inner_no_memory
def fill_expected(view: int, light: LightSpace) -> None:
    """Fill `light.expected` (4,), T ℓ, and `light.spread` (2,), the variances of its last two by what the last step
    left open about ℓ; 0 before the first."""
    rows, mean, L, y = light.rows, light.mean[view], light.factor[view], light.monomials
    for a in range(4):
        total = 0.0
        for k in range(LIGHT_TERMS):
            total += rows[a, k] * mean[k]
        light.expected[a] = total
    for a in range(2):
        variance = 0.0
        if light.solved[view] > 0:
            for i in range(LIGHT_TERMS):
                s = rows[2 + a, i]
                for k in range(i):
                    s -= L[i, k] * y[k]
                y[i] = s / L[i, i]
                variance += y[i] * y[i]
        light.spread[a] = variance


@inner_no_memory
def add_stretch_to_light(
    view: int, iv: float, L: Any, prior: Any, c: Any, coupling: Any, top: int, light: LightSpace
) -> None:
    """Add a stretch to the equations of the light: with `prior` (4,) the information that ties its intensities c to
    T ℓ, in units of 1/iv, and L the factor of their normal matrix. `coupling` (PARAMETERS, 4) is that of the pose."""
    rows, matrix, right, X = light.rows, light.matrix[view], light.right[view], light.coupling[view]
    W, e = light.stretch, light.solution
    for a in range(4):
        for b in range(4):
            e[b] = 0.0
        e[a] = 1.0
        solve_factored(L, 4, e, e)
        for b in range(4):
            W[a, b] = -iv * prior[a] * e[b] * prior[b]
        W[a, a] += iv * prior[a]
    for a in range(4):
        if prior[a] > 0.0:
            off = iv * prior[a] * (c[a] - light.expected[a])
            for k in range(LIGHT_TERMS):
                right[k] += rows[a, k] * off
    for i in range(LIGHT_TERMS):
        w0, w1, w2, w3 = 0.0, 0.0, 0.0, 0.0
        for a in range(4):
            r = rows[a, i]
            w0 += r * W[a, 0]
            w1 += r * W[a, 1]
            w2 += r * W[a, 2]
            w3 += r * W[a, 3]
        for k in range(i + 1):
            matrix[i, k] += w0 * rows[0, k] + w1 * rows[1, k] + w2 * rows[2, k] + w3 * rows[3, k]
    for b in range(top):
        solve_factored(L, 4, coupling[b], e)
        for a in range(4):
            v = prior[a] * e[a]
            if v != 0.0:
                for k in range(LIGHT_TERMS):
                    X[k, b] += rows[a, k] * v


# --- one picture


@inner_no_memory
def begin_light(known: LightPrior, light: LightSpace) -> None:
    """Begin a picture with what is known of the light: by the clip, else from the picture before."""
    for view in range(light.level.shape[0]):
        light.solved[view] = 0
        light.sums[view, 0], light.sums[view, 1] = 0.0, 0.0
        for a in range(4):
            light.surface_cost[view, a] = 0.0
        for f in range(light.part_deviation.shape[1]):
            light.part_deviation[view, f], light.part_matrix[view, f, f] = 0.0, 0.0
        level, deviation, kept = known.level[view], known.deviation[view], False
        if level == 0.0:
            level, kept = light.kept_level[view], True
            deviation = DEVIATION_SHARE * level
        light.level[view], light.deviation[view] = level, deviation
        if level > 0.0:
            mean = light.kept_mean[view] if kept else known.mean[view]
            information = light.kept_information[view] if kept else known.information[view]
            for i in range(LIGHT_TERMS):
                light.mean[view, i] = mean[i]
                light.prior_mean[view, i] = mean[i]
                for k in range(LIGHT_TERMS):
                    light.information[view, i, k] = information[i, k]


@inner_no_memory
def clear_light(view: int, light: LightSpace) -> None:
    """Clear the equations of the light in a view, and what the strips of another view left of their brightness."""
    for j in range(STRIP_CELLS + 1):
        light.left[j] = 0.0
    matrix, coupling, right = light.matrix[view], light.coupling[view], light.right[view]
    for i in range(LIGHT_TERMS):
        right[i] = 0.0
        for k in range(LIGHT_TERMS):
            matrix[i, k] = 0.0
        for a in range(coupling.shape[1]):
            coupling[i, a] = 0.0


@inner_no_memory
def eliminate_light(light: LightSpace, view: int, top: int, H: Any, g: Any) -> None:
    """Eliminate the light of a view from its equations: the `top` leading rows of H (lower half) and g."""
    light.solved[view] = 0
    if not light.level[view] > 0.0:
        return
    matrix, X, right, L, y = (
        light.matrix[view],
        light.coupling[view],
        light.right[view],
        light.factor[view],
        light.solution,
    )
    for i in range(LIGHT_TERMS):
        for k in range(LIGHT_TERMS):
            right[i] -= light.information[view, i, k] * (light.mean[view, k] - light.prior_mean[view, k])
        for k in range(i + 1):
            matrix[i, k] += light.information[view, i, k]
    if not cholesky_factor(matrix, LIGHT_TERMS, L, LEAST_LIGHT_PIVOT):
        return
    light.solved[view] = 1
    for a in range(top):
        for i in range(LIGHT_TERMS):
            y[i] = X[i, a]
        solve_factored(L, LIGHT_TERMS, y, y)
        for i in range(LIGHT_TERMS):
            g[a] -= y[i] * right[i]
            for b in range(a, top):
                H[b, a] -= y[i] * X[i, b]


@inner_no_memory
def update_light(light: LightSpace, step: Any) -> None:
    """Update the light after a step (6,) of the pose; where nothing was known of it, begin with the mean grey of the
    faces and lamps anywhere."""
    for view in range(light.level.shape[0]):
        if light.solved[view] > 0:
            y = light.solution
            for i in range(LIGHT_TERMS):
                y[i] = light.right[view, i]
                for a in range(CONTOUR):
                    y[i] -= light.coupling[view, i, a] * step[a]
            solve_factored(light.factor[view], LIGHT_TERMS, y, y)
            for i in range(LIGHT_TERMS):
                light.mean[view, i] += y[i]
            _update_deviations(view, light, step, y)
        elif light.level[view] == 0.0 and light.sums[view, 0] > 0.0:
            level = light.sums[view, 1] / light.sums[view, 0]
            if level > 0.0:
                lamps_anywhere(view, light, level)


@inner_no_memory
def lamps_anywhere(view: int, light: LightSpace, level: float) -> None:
    """Begin with a mean brightness [grey], and lamps in unknown directions."""
    light.level[view], light.deviation[view] = level, DEVIATION_SHARE * level
    for i in range(LIGHT_TERMS):
        light.mean[view, i] = level if i == 0 else 0.0
        light.prior_mean[view, i] = light.mean[view, i]
        for k in range(LIGHT_TERMS):
            light.information[view, i, k] = LAMP_PRIOR[i, k] / (level * level)


@inner_no_memory
def _update_deviations(view: int, light: LightSpace, step: Any, change: Any) -> None:
    """Update what the parts of the surface deviate from the light after a step (6,) of the pose and a change (LIGHT_TERMS,)
    of the light."""
    parts, left = light.part_matrix.shape[1], light.part_right[view]
    if not light.part_matrix[view, 0, 0] > 0.0:
        return
    for f in range(parts):
        coupling = light.part_coupling[view, f]
        for a in range(CONTOUR):
            left[f] -= coupling[a] * step[a]
        for i in range(LIGHT_TERMS):
            left[f] -= coupling[PARAMETERS + i] * change[i]
    solve_factored(light.part_matrix[view], parts, left, left)
    for f in range(parts):
        light.part_deviation[view, f] += left[f]


@compiled(nogil=True)
def keep_light(light: LightSpace, A: Any) -> None:
    """Keep what a picture shows of the light for the next picture. A (6, 6) is the information about the pose, with the
    light eliminated."""
    joint, factor, y = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros(6)
    Y = np.zeros((LIGHT_TERMS, 6))
    e = np.zeros(LIGHT_TERMS)
    for view in range(light.level.shape[0]):
        if light.solved[view] == 0:
            continue
        X, M, L = light.coupling[view], light.matrix[view], light.factor[view]
        for a in range(6):
            for i in range(LIGHT_TERMS):
                e[i] = X[i, a]
            solve_factored(L, LIGHT_TERMS, e, e)
            for i in range(LIGHT_TERMS):
                Y[i, a] = e[i]
        for a in range(6):
            for b in range(6):
                joint[a, b] = A[a, b]
                for i in range(LIGHT_TERMS):
                    joint[a, b] += Y[i, a] * X[i, b]
        if not cholesky_factor(joint, np.int64(6), factor, LEAST_LIGHT_PIVOT):
            continue
        light.kept_level[view] = light.level[view]
        for i in range(LIGHT_TERMS):
            light.kept_mean[view, i] = light.mean[view, i]
            for a in range(6):
                y[a] = X[i, a]
            solve_factored(factor, np.int64(6), y, y)
            for k in range(i + 1):
                information = M[i, k]
                for a in range(6):
                    information -= y[a] * X[k, a]
                light.kept_information[view, i, k] = MEMORY * information
                light.kept_information[view, k, i] = MEMORY * information


def kept_light(work: Workspace) -> tuple[Array, Array, Array]:
    """Level, coefficients and information of the light that a workspace keeps from picture to picture, to be changed in
    place."""
    return work.light.kept_level, work.light.kept_mean, work.light.kept_information
