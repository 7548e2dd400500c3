"""Bundle adjustment: flights and the places of textures on a die's faces, fitted together (see `marks`).

Unknowns are twelve numbers a flight, WARPS for each marked face, the lens blur, the height of the table, and the instant of
each bounce. The normal equations of single frames come from the pixels; a texture's warps stand for all that learning it
again from other poses could do to it, so that a step goes to where poses and textures agree, and not only to where the poses
agree with textures that they have placed themselves. Flights meet at their bounces, and where a bounce is an impact at one
vertex, they obey there what impacts obey (`joined`): how far away the die is, marks tell by its turns and its fall, and
less well than the table does, which its corner touches.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from ...model.rotations import matrix_from_quat, rotation_between
from ...model.throw import Flight, Throw
from ..picture import THREADS, View
from ..throw import (
    CONTACT_SIGMA_M,
    LATERAL_SHARE,
    TABLE_SIGMA_M,
    VertexImpact,
    perturbed,
    transition_matrix,
    vertex_impact_equations,
)
from .kernel_types import BUFFER, SHARED, WARPS, Faces, Optics, new_bench
from .mark_equations import mark_equations
from .textures import Look, Marks, Poses, faces_of, optics_of, poses_of

Array = NDArray[np.float64]

PRIOR_WARP = 0.02
"""Standard deviation of a texture's warps, where the die's edge is the unit of length: several times what the worst edges
misplace it."""
PRIOR_BLUR, PRIOR_LENS_PX = 1.0, 0.3
"""Standard deviations of a texture's blur [texel², as variance] and of the lens blur [px]."""
BLUR_RANGE_PX = (0.3, 4.0)
"""A pixel alone has 0.29; beyond the other there would be no marks."""
LINK_M, LINK_RAD = 1e-5, 5e-4
"""How well flights meet at a bounce: a contact lasts some 0.05 ms, in which a die leaves the corner between its two motions by a
quarter of that time its speed."""
PRIOR_INSTANT_S, SURE_INSTANT_S = 2e-3, 1e-6
"""What marks may move the instant of a bounce by; and how unsure one is at the least that stays as edges have it: a die comes
down by a micrometre meanwhile."""
CONTOUR_SHARES = (1e-4, 0.3)
"""Between which the common error of edges is looked for, over the die's edge."""
TOGETHER_RAD = 0.4
"""Turn of a die over which its edges are taken to err alike. Asked of single frames, whose bevels err by tenths of a degree each,
their common error came out at a third of what means over such a turn have, and edges of rounded dice drew flights along."""
CHI2_MEDIAN = 5.348
"""Median of chi-square with six degrees of freedom."""


@dataclass(frozen=True, eq=False)
class Bounce:
    """What flights that are looked at have to do with an impact."""

    flights: tuple[int, ...]
    """Those beside it that are looked at: both, or one."""
    time_s: float
    sigma_s: float
    """How well that instant is known before the marks tell it."""
    strike: VertexImpact | None
    """None where the contact was not at one vertex: the flights meet there and obey nothing else."""


def bounces_between(looks: list[Look], throw: Throw, strikes: Sequence[VertexImpact | None]) -> list[Bounce]:
    """The bounces of a throw, whose impacts were those strikes (impacts,), that tell of flights which are looked at: of both
    beside it, or of one where the other is too short to be."""
    used, out = {look.flight for look in looks}, []
    for k, (impact, strike) in enumerate(zip(throw.impacts, strikes, strict=True)):
        beside = tuple(i for i in (k, k + 1) if i in used and impact.contact != "unresolved")
        if len(beside) == 2:
            out.append(Bounce(beside, impact.time_s, PRIOR_INSTANT_S, strike))
        elif len(beside) == 1 and strike is not None and np.isfinite(impact.sigma_time_s):
            out.append(Bounce(beside, impact.time_s, max(impact.sigma_time_s, SURE_INSTANT_S), strike))
    return out


def adjusted(view: View, looks: list[Look], bounces: list[Bounce], marks: Marks, cut: float) -> tuple[Marks, Array]:
    """Flights moved to where marks that sit anywhere on their faces, and weakly the edges, want them; and how far each
    flight was moved, (flights,) in sigmas of what moved most, 0 for one without a look.

    Unknowns are twelve numbers a flight, the warps of each marked face's texture, the lens blur, the height of the table, and
    the instant of each bounce, at which position and orientation go on without a jump.
    """
    used = np.unique([look.flight for look in looks])
    column = {int(k): 12 * i for i, k in enumerate(used)}
    place_of = {int(f): 12 * len(used) + WARPS * i for i, f in enumerate(marks.marked_faces)}
    blur_at = 12 * len(used) + WARPS * len(place_of)
    table_at = blur_at + SHARED
    in_flight = np.bincount([look.flight for look in looks])
    poses = poses_of(looks, marks.flights)
    equations = _equations(optics_of(view, marks), faces_of(view, marks, cut), looks, poses)
    edges = _edges_minus_flights(looks, poses)
    squared = _whitened_squares(np.array([H for H, *_ in equations]), np.array([g for _, g, *_ in equations]))
    factor = max(1.0, float(np.median(squared)) / CHI2_MEDIAN) if len(squared) else marks.factor
    # Times the looks of the flight, so that what the edges get wrong alike does not shrink with their number.
    shared = in_flight[[look.flight for look in looks]][:, None, None] * _contours(view, looks, marks.contour_m)
    informations = np.linalg.inv(np.array([look.edge_covariance for look in looks]) + shared)
    A = np.diag(_priors(view, len(used), len(place_of), bounces))
    y = np.zeros(len(A))
    terms = zip(looks, equations, informations, poses.by_start, edges, strict=True)
    for look, (H, g, place, _), E, M, away in terms:
        c = slice(column[look.flight], column[look.flight] + 12)
        A[c, c] += M.T @ (H / factor + E) @ M
        y[c] += M.T @ (g / factor + E @ away)
        for f, at in place_of.items():
            if not place[f].any():
                continue
            s = np.r_[at : at + WARPS, blur_at]
            cross = M.T @ place[f][:, :6].T / factor
            A[c, s] += cross
            A[s, c] += cross.T
            A[np.ix_(s, s)] += place[f][:, 6:-1] / factor
            y[s] += place[f][:, -1] / factor
    for i, bounce in enumerate(bounces):
        J, gap = _bounce_equations(marks.flights, bounce)
        s = np.concatenate(
            [*(np.arange(column[k], column[k] + 12) for k in bounce.flights), [table_at + 1 + i, table_at]]
        )
        A[np.ix_(s, s)] += J.T @ J
        y[s] += J.T @ gap
    C = _inverse(A)
    step = C @ y
    # What would be left if the textures' places and the table's height were known: the rest of C is common to all frames.
    sure = np.r_[0 : 12 * len(used), table_at + 1 : len(A)]
    own = _inverse(A[np.ix_(sure, sure)])
    flights, common = list(marks.flights), list(marks.shared)
    for k, at in column.items():
        c = slice(at, at + 12)
        flights[k] = replace(flights[k], start=perturbed(flights[k].start, step[c]), covariance=C[c, c])
        common[k] = C[c, c] - own[c, c]
    moves = np.zeros(len(flights))
    for k, at in column.items():
        moves[k] = float(np.max(np.abs(step[at : at + 12]) / np.sqrt(np.diag(C)[at : at + 12])))
    blur = marks.blur_px * float(np.clip(1.0 + step[blur_at] / marks.blur_px, 0.7, 1.4))
    noise = np.array([np.where(stats[:, 1] > 0, stats[:, 2], np.nan) for _, _, _, stats in equations])
    usual = np.nanmedian(np.where(np.isfinite(noise).any(0), noise, 0.0), axis=0)
    new = replace(
        marks, flights=tuple(flights), shared=tuple(common), factor=factor,
        blur_px=float(np.clip(blur, *BLUR_RANGE_PX)), noise_grey=np.where(marks.noise_grey > 0, usual, 0.0),
    )  # fmt: skip
    return replace(new, contour_m=_contour_error(view, looks, new)), moves


def _priors(view: View, flights: int, faces: int, bounces: Sequence[Bounce]) -> Array:
    """Diagonal of the prior's information, in the order of the unknowns."""
    edge = view.die.solid.edge_m
    warp = PRIOR_WARP * np.array([edge, edge, 1.0, 1.0, 1.0, 1.0, 1.0 / edge, 1.0 / edge])
    places = np.tile(1.0 / np.append(warp, PRIOR_BLUR) ** 2, faces)
    shared = 1.0 / np.array([PRIOR_LENS_PX, TABLE_SIGMA_M]) ** 2
    instants = [1.0 / bounce.sigma_s**2 for bounce in bounces]
    return np.concatenate([np.zeros(12 * flights), places, shared, instants])


def _bounce_equations(flights: Sequence[Flight], bounce: Bounce) -> tuple[Array, Array]:
    """Rows and right side, in sigmas, by the starts of the bounce's flights (12 each), by its instant, and by the height of the
    table: flights on both sides meet (6 rows), and where it is a strike, they obey it (4). Of one flight alone its corner
    touches the table (1)."""
    t, motions = bounce.time_s, [flights[k] for k in bounce.flights]
    states, onward = [motion.at(t) for motion in motions], [transition_matrix(motion, t) for motion in motions]
    rows, right = np.zeros((0, 26)), np.zeros(0)
    if bounce.strike is not None:
        obeyed, miss = vertex_impact_equations(states[0], states[-1], bounce.strike, 0.0)
        by_table = np.array([[-1.0 / CONTACT_SIGMA_M], [0.0], [0.0], [0.0]])
        by_starts = [obeyed[:, :12] @ onward[0], obeyed[:, 12:24] @ onward[-1]]
        rows, right = np.hstack([*by_starts, obeyed[:, 24:], by_table]), -miss
    if len(motions) == 1:
        return np.delete(rows[:1], np.s_[12:24], axis=1), right[:1]
    a, b = states
    gap = np.concatenate([b.position_m - a.position_m, rotation_between(a.quaternion, b.quaternion)])
    drift = np.concatenate([b.velocity_m_s - a.velocity_m_s, b.omega_rad_s - a.omega_rad_s])
    sigma = np.array([LINK_M] * 3 + [LINK_RAD] * 3)
    meet = np.hstack([onward[0][:6], -onward[1][:6], -drift[:, None], np.zeros((6, 1))]) / sigma[:, None]
    return np.vstack([meet, rows]), np.concatenate([gap / sigma, right])


def _inverse(A: Array) -> Array:
    """Inverse of a normal matrix whose unknowns have different units."""
    unit = 1.0 / np.sqrt(np.diag(A))
    scaled = A * np.outer(unit, unit)
    # Far below any direction that was observed, and enough for one that only rounding tells from none.
    scaled[np.diag_indices_from(scaled)] += 1e-12
    return np.asarray(np.linalg.inv(scaled) * np.outer(unit, unit))


def contour_covariance(view: View, position_m: Array, contour_m: float) -> Array:
    """(..., 6, 6) of poses (..., 3) from edges that all lie `contour_m` off, in world axes: sideways by as much, in distance
    by the share of the die's size that it is, and turned by it over half the die's size."""
    toward = position_m - view.camera.centre_m
    distance = np.linalg.norm(toward, axis=-1)[..., None, None]
    ray = toward[..., :, None] / distance
    size = 2.0 * view.reach_m
    out = np.zeros((*toward.shape[:-1], 6, 6))
    out[..., :3, :3] = contour_m**2 * (
        np.eye(3) + ((2.0 * distance / size) ** 2 - 1.0) * ray * np.swapaxes(ray, -1, -2)
    )
    out[..., 3:, 3:] = (2.0 * contour_m / size) ** 2 * np.eye(3)
    return out


def _contours(view: View, looks: list[Look], contour_m: float) -> Array:
    """(looks, 6, 6) `contour_covariance` of the edges' poses."""
    return contour_covariance(view, np.array([look.edge_position_m for look in looks]), contour_m)


def _contour_error(view: View, looks: list[Look], marks: Marks) -> float:
    """The length [m] that makes the edges' distance from the flights what their own covariances and `contour_covariance`
    together expect, in means over looks of one flight that follow each other: in a single one it may be hidden by what the
    frame errs for itself. No less than what the edges of a rounded die are known to be off aside (`lean`): what they err alike
    through all flights moves the marks with it, and is not seen here."""
    away = _edges_minus_flights(looks, poses_of(looks, marks.flights))
    own = np.linalg.inv(np.array([look.edge_covariance for look in looks]))
    groups = _alike(looks, marks.flights)
    spreads = np.array([np.linalg.inv(own[rows].sum(0)) for rows in groups])
    sums = np.array([np.einsum("nij,nj->i", own[rows], away[rows]) for rows in groups])
    means = np.einsum("gij,gj->gi", spreads, sums)
    every = _contours(view, looks, 1.0)
    unit = np.array([every[rows].mean(0) for rows in groups])

    def beyond(log_length: float) -> float:
        spread = spreads + np.exp(2.0 * log_length) * unit
        squared = np.einsum("gi,gi->g", means, np.linalg.solve(spread, means[..., None])[..., 0])
        return float(np.median(squared)) - CHI2_MEDIAN

    least, most = np.log(np.array(CONTOUR_SHARES) * view.die.solid.edge_m)
    known = LATERAL_SHARE * view.die.corner_radius_m
    if beyond(least) <= 0.0:
        return max(float(np.exp(least)), known)
    return max(float(np.exp(most if beyond(most) >= 0.0 else brentq(beyond, least, most, xtol=0.01))), known)


def _alike(looks: list[Look], flights: Sequence[Flight]) -> list[NDArray[np.int64]]:
    """Rows of looks in groups that follow each other in one flight, while the die turns by TOGETHER_RAD at the most."""
    group_of = []
    for look in looks:
        start = flights[look.flight].start
        turned = float(np.linalg.norm(start.omega_rad_s)) * (look.time_s - start.time_s)
        group_of.append((look.flight, int(turned / TOGETHER_RAD)))
    _, which = np.unique(np.array(group_of), axis=0, return_inverse=True)
    return [np.flatnonzero(which.ravel() == k) for k in range(int(which.max()) + 1)]


def _equations(
    optics: Optics, faces: Faces, looks: list[Look], poses: Poses
) -> list[tuple[Array, Array, Array, Array]]:
    """Normal equations of every look at the pose of its flight."""
    count = len(faces.counts)

    def of_some(some: NDArray[np.int64]) -> list[tuple[Array, Array, Array, Array]]:
        bench, out = new_bench(BUFFER, faces.coefficients.shape[1]), []
        for i in some:
            look, H, g = looks[i], np.zeros((6, 6)), np.zeros(6)
            place, stats = np.zeros((count, WARPS + SHARED, 7 + WARPS + SHARED)), np.zeros((count, 3))
            mark_equations(
                look.image, look.x0, look.y0, optics, faces, poses.position_m[i], poses.rotation[i],
                poses.velocity_m_s[i], poses.omega_rad_s[i], True, bench, H, g, place, stats,
            )  # fmt: skip
            out.append((H, g, place, stats))
        return out

    with ThreadPoolExecutor(THREADS) as pool:
        return [one for part in pool.map(of_some, np.array_split(np.arange(len(looks)), THREADS)) for one in part]


def _edges_minus_flights(looks: list[Look], poses: Poses) -> Array:
    """(looks, 6) from the flights' poses to those of the edges."""
    moved_m = np.array([look.edge_position_m for look in looks]) - poses.position_m
    edges = matrix_from_quat(np.array([look.edge_quaternion for look in looks]))
    return np.concatenate([moved_m, turn_between(poses.rotation, edges)], axis=1)


def turn_between(start: Array, end: Array) -> Array:
    """Rotation vectors (..., 3), world axes, that take orientations (..., 3, 3) to others less than half a turn away."""
    D = end @ np.swapaxes(start, -1, -2)
    axis = 0.5 * np.stack([D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]], -1)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, 0.5 * (np.trace(D, axis1=-2, axis2=-1)[..., None] - 1.0))
    return np.asarray(axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0))


def _whitened_squares(H: Array, g: Array) -> Array:
    """gᵀ H⁻¹ g of normal equations (n, 6, 6) and (n, 6): how far, in squared sigmas, the marks of each frame alone want to move
    its pose. Without those that leave a direction open."""
    unit = np.sqrt(np.diagonal(H, axis1=1, axis2=2))
    shown = np.asarray((unit > 0).all(1))
    H, g, unit = H[shown], g[shown], unit[shown]
    values, vectors = np.linalg.eigh(H / (unit[:, :, None] * unit[:, None, :]))
    closed = values[:, 0] >= 1e-6 * values[:, -1]
    along = np.einsum("ni,nij->nj", g / unit, vectors)[closed]
    return np.asarray((along**2 / values[closed]).sum(1))
