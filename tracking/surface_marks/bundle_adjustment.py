"""Bundle adjustment: flights and the placement of textures on a die's faces, fitted together (Gauss-Newton).

Unknowns are the initial state of each flight (12 numbers), WARPS for each marked face, the height of the table, and the
time of each impact. The pixels give the normal equations of single frames. A texture's warps represent the change from
learning it again at other poses. A step therefore goes to where poses and textures agree, and not to where the poses
agree with textures that they have placed themselves. Flights meet at their impacts, and at an impact on one vertex they
obey the law of impacts (`flight_chain`). Marks determine the distance of the die by its rotation and its fall, but less
accurately than the table does, which its corner touches.

The lens blur is that of the edges. A texture contains noise of the frames that it is compared with, so that a sharper one
always seems to fit: estimated with the flights, the blur of one clip went from 0.8 to 0.6 px in seven rounds and to 0.3 px
in twenty.
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
from ..flights import (
    CONTACT_SIGMA_M,
    TABLE_SIGMA_M,
    VertexImpact,
    perturbed,
    transition_matrix,
    vertex_impact_equations,
)
from ..picture import THREADS, View
from ..throw import LATERAL_SHARE
from .kernel_types import MOST_PIXELS, WARPS, new_workspace
from .mark_equations import MarkEquations, mark_equations
from .textures import FlightPoses, FrameWindow, SurfaceMarks, faces_of, flight_poses, optics_of

Array = NDArray[np.float64]

PRIOR_WARP = 0.02
"""Standard deviation of a texture's warps, in units of the die's edge: several times the misplacement by the worst
edges."""
PRIOR_BLUR_TEXEL2 = 1.0
"""Standard deviation of a texture's blur, a variance."""
JUNCTION_SIGMA_M = 1e-5
"""How well the positions of two flights meet at an impact: a contact lasts some 0.05 ms, in which a die departs from
the corner between its two motions by a quarter of that time times its speed."""
JUNCTION_SIGMA_RAD = 5e-4
"""The same for the orientations."""
PRIOR_TIME_S = 2e-3
"""Standard deviation of the time of an impact between two flights that are adjusted."""
LEAST_TIME_SIGMA_S = 1e-6
"""Least standard deviation of the time of an impact that edges alone determine: a die falls by a micrometre
meanwhile."""
LEAST_CONTOUR_SHARE = 1e-4
"""Least common error of edges that is considered, over the die's edge."""
MOST_CONTOUR_SHARE = 0.3
"""Largest common error of edges that is considered, over the die's edge."""
LOG_LENGTH_TOLERANCE = 0.01
"""Relative accuracy of that error."""
CORRELATION_ANGLE_RAD = 0.4
"""Rotation of a die over which the errors of its edges are correlated. Single frames, whose bevels have errors of
tenths of a degree each, gave a third of the common error that means over such a rotation have, and edges of rounded
dice biased flights."""
CHI2_MEDIAN = 5.348
"""Median of chi-square with six degrees of freedom."""
DAMPING = 1e-12
"""Added to the diagonal of a scaled normal matrix: far below any direction that was observed, and enough for one that
only rounding distinguishes from singular."""
LEAST_EIGENVALUE_RATIO = 1e-6
"""Ratio of the extreme eigenvalues of a frame's scaled normal equations below which it leaves a direction
undetermined."""


@dataclass(frozen=True, eq=False)
class ImpactConstraint:
    """What one impact says about the flights beside it that are adjusted."""

    flights: tuple[int, ...]
    """Both flights beside it, or the one that is adjusted."""
    time_s: float
    sigma_s: float
    """Prior standard deviation of that time."""
    vertex_impact: VertexImpact | None
    """None where the contact was not at one vertex: the flights meet there and obey nothing else."""


def impact_constraints(
    windows: list[FrameWindow], throw: Throw, vertex_impacts: Sequence[VertexImpact | None]
) -> list[ImpactConstraint]:
    """The constraints from the impacts of a throw on the flights that have windows.

    `vertex_impacts` (impacts,) are the laws of the impacts, None for one that was not at one vertex. An impact constrains
    both flights beside it, or one if the other is too short to have windows.
    """
    adjusted, out = {window.flight for window in windows}, []
    for k, (impact, vertex_impact) in enumerate(zip(throw.impacts, vertex_impacts, strict=True)):
        flights = tuple(i for i in (k, k + 1) if i in adjusted and impact.contact != "unresolved")
        if len(flights) == 2:
            out.append(ImpactConstraint(flights, impact.time_s, PRIOR_TIME_S, vertex_impact))
        elif len(flights) == 1 and vertex_impact is not None and np.isfinite(impact.sigma_time_s):
            sigma_s = max(impact.sigma_time_s, LEAST_TIME_SIGMA_S)
            out.append(ImpactConstraint(flights, impact.time_s, sigma_s, vertex_impact))
    return out


@dataclass(frozen=True)
class _Layout:
    """Columns of the unknowns: flights, warps of faces, height of the table, times of impacts."""

    flights: dict[int, slice]
    """By number, those that have windows: 12 columns each."""
    warps: dict[int, int]
    """First column of each marked face's warps."""
    table: int
    impacts: int
    """How many there are; their times follow the table."""

    @staticmethod
    def of(windows: list[FrameWindow], marks: SurfaceMarks, impacts: int) -> _Layout:
        used = np.unique([window.flight for window in windows])
        flights = {int(k): slice(12 * i, 12 * i + 12) for i, k in enumerate(used)}
        first = 12 * len(used)
        warps = {int(f): first + WARPS * i for i, f in enumerate(marks.marked_faces)}
        return _Layout(flights, warps, first + WARPS * len(warps), impacts)

    def of_impact(self, i: int, impact: ImpactConstraint) -> NDArray[np.int64]:
        """Columns of an impact's flights, its time, and the table."""
        flights = [np.r_[self.flights[k]] for k in impact.flights]
        return np.concatenate([*flights, [self.table + 1 + i, self.table]])

    @property
    def certain_placement(self) -> NDArray[np.int64]:
        """Columns of what remains unknown if the placement of the textures and the height of the table are known."""
        return np.r_[0 : 12 * len(self.flights), self.table + 1 : self.table + 1 + self.impacts]


def adjust_flights(
    view: View, windows: list[FrameWindow], impacts: list[ImpactConstraint], marks: SurfaceMarks, cut: float
) -> tuple[SurfaceMarks, Array]:
    """One adjustment step of the flights, on marks that may be misplaced on their faces, and weakly on edges.

    Returns the marks with the adjusted flights, and how far each flight moved: (flights,) in sigmas of its parameter
    that moved most, 0 for a flight without windows. At an impact, position and orientation are continuous.
    """
    poses = flight_poses(windows, marks.flights)
    equations = _equations_of_windows(view, marks, windows, poses, cut)
    squared = _whitened_squares(np.array([e.H for e in equations]), np.array([e.g for e in equations]))
    factor = max(1.0, float(np.median(squared)) / CHI2_MEDIAN) if len(squared) else marks.variance_factor
    layout = _Layout.of(windows, marks, len(impacts))
    A, y = _normal_equations(view, windows, poses, equations, impacts, replace(marks, variance_factor=factor), layout)
    C = _inverse(A)
    step = C @ y
    # The covariance for known placement and table: the rest of C is common to all frames.
    sure = layout.certain_placement
    own = _inverse(A[np.ix_(sure, sure)])
    flights, shared, moves = list(marks.flights), list(marks.shared_covariance), np.zeros(len(marks.flights))
    for k, c in layout.flights.items():
        flights[k] = replace(flights[k], start=perturbed(flights[k].start, step[c]), covariance=C[c, c])
        shared[k] = C[c, c] - own[c, c]
        moves[k] = float(np.max(np.abs(step[c]) / np.sqrt(np.diag(C)[c])))
    adjusted = replace(
        marks,
        flights=tuple(flights),
        shared_covariance=tuple(shared),
        variance_factor=factor,
        noise_grey=np.where(marks.noise_grey > 0, _usual_noise(equations), 0.0),
    )
    return replace(adjusted, contour_m=_contour_error(view, windows, adjusted)), moves


def _normal_equations(
    view: View, windows: list[FrameWindow], poses: FlightPoses, equations: list[MarkEquations],
    impacts: list[ImpactConstraint], marks: SurfaceMarks, layout: _Layout,
) -> tuple[Array, Array]:  # fmt: skip
    """Normal matrix and right side of all unknowns: priors, marks, edges and impacts."""
    factor = marks.variance_factor
    flight_of = [window.flight for window in windows]
    # Multiplied by the number of windows in the flight, so that the edges' common error does not shrink with it.
    common = np.bincount(flight_of)[flight_of][:, None, None] * _contours(view, windows, marks.contour_m)
    edge_informations = np.linalg.inv(np.array([window.edge_covariance for window in windows]) + common)
    edges = _edges_minus_flights(windows, poses)
    A = np.diag(_priors(view, layout, impacts))
    y = np.zeros(len(A))
    terms = zip(windows, equations, edge_informations, poses.by_initial_state, edges, strict=True)
    for window, of_marks, edge_information, M, difference in terms:
        c = layout.flights[window.flight]
        A[c, c] += M.T @ (of_marks.H / factor + edge_information) @ M
        y[c] += M.T @ (of_marks.g / factor + edge_information @ difference)
        for f, at in layout.warps.items():
            rows = of_marks.warps[f]
            if not rows.any():
                continue
            w = slice(at, at + WARPS)
            cross = M.T @ rows[:, :6].T / factor
            A[c, w] += cross
            A[w, c] += cross.T
            A[w, w] += rows[:, 6:-1] / factor
            y[w] += rows[:, -1] / factor
    for i, impact in enumerate(impacts):
        J, gap = _impact_equations(marks.flights, impact)
        s = layout.of_impact(i, impact)
        A[np.ix_(s, s)] += J.T @ J
        y[s] += J.T @ gap
    return A, y


def _usual_noise(equations: list[MarkEquations]) -> Array:
    """(faces,) median noise over the frames that show a face; 0 for faces that none shows."""
    noise = np.array([np.where(e.stats[:, 1] > 0, e.stats[:, 2], np.nan) for e in equations])
    return np.asarray(np.nanmedian(np.where(np.isfinite(noise).any(0), noise, 0.0), axis=0))


def _priors(view: View, layout: _Layout, impacts: Sequence[ImpactConstraint]) -> Array:
    """Diagonal of the prior's information, in the order of the unknowns."""
    edge = view.die.solid.edge_m
    warp = PRIOR_WARP * np.array([edge, edge, 1.0, 1.0, 1.0, 1.0, 1.0 / edge, 1.0 / edge])
    warps = np.tile(1.0 / np.append(warp, PRIOR_BLUR_TEXEL2) ** 2, len(layout.warps))
    times = [1.0 / impact.sigma_s**2 for impact in impacts]
    return np.concatenate([np.zeros(12 * len(layout.flights)), warps, [1.0 / TABLE_SIGMA_M**2], times])


def _impact_equations(flights: Sequence[Flight], impact: ImpactConstraint) -> tuple[Array, Array]:
    """Rows and right side, in sigmas, by the initial states of the impact's flights (12 each), its time, and the
    table's height.

    Two flights meet (6 rows), and obey the law of an impact on one vertex (4 rows). The corner of one flight alone
    touches the table (1 row).
    """
    t, beside = impact.time_s, [flights[k] for k in impact.flights]
    states, transitions = [flight.at(t) for flight in beside], [transition_matrix(flight, t) for flight in beside]
    rows, right = np.zeros((0, 26)), np.zeros(0)
    if impact.vertex_impact is not None:
        gravity_m_s2 = beside[0].gravity_m_s2
        law, violation = vertex_impact_equations(states[0], states[-1], impact.vertex_impact, 0.0, gravity_m_s2)
        by_table = np.array([[-1.0 / CONTACT_SIGMA_M], [0.0], [0.0], [0.0]])
        by_states = [law[:, :12] @ transitions[0], law[:, 12:24] @ transitions[-1]]
        rows, right = np.hstack([*by_states, law[:, 24:], by_table]), -violation
    if len(beside) == 1:
        return np.delete(rows[:1], np.s_[12:24], axis=1), right[:1]
    a, b = states
    gap = np.concatenate([b.position_m - a.position_m, rotation_between(a.quaternion, b.quaternion)])
    velocity_change = np.concatenate([b.velocity_m_s - a.velocity_m_s, b.omega_rad_s - a.omega_rad_s])
    sigma = np.array([JUNCTION_SIGMA_M] * 3 + [JUNCTION_SIGMA_RAD] * 3)
    columns = [transitions[0][:6], -transitions[1][:6], -velocity_change[:, None], np.zeros((6, 1))]
    meet = np.hstack(columns) / sigma[:, None]
    return np.vstack([meet, rows]), np.concatenate([gap / sigma, right])


def _inverse(A: Array) -> Array:
    """Inverse of a normal matrix whose unknowns have different units."""
    unit = 1.0 / np.sqrt(np.diag(A))
    scaled = A * np.outer(unit, unit)
    scaled[np.diag_indices_from(scaled)] += DAMPING
    return np.asarray(np.linalg.inv(scaled) * np.outer(unit, unit))


def contour_covariance(view: View, position_m: Array, contour_m: float) -> Array:
    """(..., 6, 6) common covariance, world axes, of poses by edges at positions (..., 3) if all edges are displaced
    by `contour_m`: sideways by as much, in distance by the same share as of the die's size, and in rotation by it
    over half that size."""
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


def _contours(view: View, windows: list[FrameWindow], contour_m: float) -> Array:
    """(windows, 6, 6) `contour_covariance` of the edges' poses."""
    return contour_covariance(view, np.array([window.edge_position_m for window in windows]), contour_m)


def _contour_error(view: View, windows: list[FrameWindow], marks: SurfaceMarks) -> float:
    """The length [m] for which the edges' deviations from the flights have their expected size, given their own
    covariances and `contour_covariance`.

    Means over consecutive windows of one flight are compared: the errors of single frames may hide the common one.
    The result is at least the known sideways displacement of a rounded die's edges (`shared_bias`): what edges have
    in common through all flights shifts the marks as well and is invisible here.
    """
    differences = _edges_minus_flights(windows, flight_poses(windows, marks.flights))
    informations = np.linalg.inv(np.array([window.edge_covariance for window in windows]))
    groups = _correlated_groups(windows, marks.flights)
    covariances = np.array([np.linalg.inv(informations[rows].sum(0)) for rows in groups])
    sums = np.array([np.einsum("nij,nj->i", informations[rows], differences[rows]) for rows in groups])
    means = np.einsum("gij,gj->gi", covariances, sums)
    unit_contours = _contours(view, windows, 1.0)
    unit = np.array([unit_contours[rows].mean(0) for rows in groups])

    edge = view.die.solid.edge_m
    known = max(LEAST_CONTOUR_SHARE * edge, LATERAL_SHARE * view.die.corner_radius_m)
    return max(common_length_m(means, covariances, unit, LEAST_CONTOUR_SHARE * edge, MOST_CONTOUR_SHARE * edge), known)


def common_length_m(differences: Array, covariances: Array, unit: Array, least_m: float, most_m: float) -> float:
    """The length [m] for which differences of poses (n, 6) have their expected size, the median of chi square, if their
    covariances (n, 6, 6) contain its square times `unit` (n, 6, 6). 0 if `least_m` is more than enough; at most `most_m`."""

    def excess(log_length: float) -> float:
        return median_square(differences, covariances + np.exp(2.0 * log_length) * unit) - CHI2_MEDIAN

    least, most = float(np.log(least_m)), float(np.log(most_m))
    if excess(least) <= 0.0:
        return 0.0
    log_length = most if excess(most) >= 0.0 else brentq(excess, least, most, xtol=LOG_LENGTH_TOLERANCE)
    return float(np.exp(log_length))


def median_square(differences: Array, covariances: Array) -> float:
    """Median over rows of the squared differences (n, 6) in the sigmas of their covariances (n, 6, 6)."""
    solved = np.linalg.solve(covariances, differences[..., None])[..., 0]
    return float(np.median(np.einsum("ni,ni->n", differences, solved)))


def _correlated_groups(windows: list[FrameWindow], flights: Sequence[Flight]) -> list[NDArray[np.int64]]:
    """Rows of windows in groups that follow each other in one flight, while the die rotates by
    CORRELATION_ANGLE_RAD."""
    group_of = []
    for window in windows:
        start = flights[window.flight].start
        rotation_rad = float(np.linalg.norm(start.omega_rad_s)) * (window.time_s - start.time_s)
        group_of.append((window.flight, int(rotation_rad / CORRELATION_ANGLE_RAD)))
    _, which = np.unique(np.array(group_of), axis=0, return_inverse=True)
    return [np.flatnonzero(which.ravel() == k) for k in range(int(which.max()) + 1)]


def _equations_of_windows(
    view: View, marks: SurfaceMarks, windows: list[FrameWindow], poses: FlightPoses, cut: float
) -> list[MarkEquations]:
    """Normal equations of every window at the pose of its flight."""
    optics, faces = optics_of(view, marks), faces_of(view, marks, cut)
    count = len(faces.counts)

    def of_some(some: NDArray[np.int64]) -> list[MarkEquations]:
        workspace, out = new_workspace(MOST_PIXELS, faces.coefficients.shape[1]), []
        for i in some:
            warps, stats = np.zeros((count, WARPS, 7 + WARPS)), np.zeros((count, 3))
            equations = MarkEquations(np.zeros((6, 6)), np.zeros(6), warps, stats)
            mark_equations(poses.frame(i, windows[i]), optics, faces, True, workspace, equations)
            out.append(equations)
        return out

    with ThreadPoolExecutor(THREADS) as pool:
        return [one for part in pool.map(of_some, np.array_split(np.arange(len(windows)), THREADS)) for one in part]


def _edges_minus_flights(windows: list[FrameWindow], poses: FlightPoses) -> Array:
    """(windows, 6) pose increments from the flights to the edges."""
    moved_m = np.array([window.edge_position_m for window in windows]) - poses.position_m
    edges = matrix_from_quat(np.array([window.edge_quaternion for window in windows]))
    return np.concatenate([moved_m, rotation_vectors(poses.rotation, edges)], axis=1)


def rotation_vectors(start: Array, end: Array) -> Array:
    """Rotation vectors (..., 3), world axes, from orientations (..., 3, 3) to others less than half a turn away."""
    D = end @ np.swapaxes(start, -1, -2)
    axis = 0.5 * np.stack([D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]], -1)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, 0.5 * (np.trace(D, axis1=-2, axis2=-1)[..., None] - 1.0))
    return np.asarray(axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0))


def _whitened_squares(H: Array, g: Array) -> Array:
    """gᵀ H⁻¹ g of normal equations (n, 6, 6) and (n, 6): the squared distance, in sigmas, of each frame's pose from
    the solution by its marks alone. Frames that leave a direction undetermined are left out."""
    unit = np.sqrt(np.diagonal(H, axis1=1, axis2=2))
    informed = np.asarray((unit > 0).all(1))
    H, g, unit = H[informed], g[informed], unit[informed]
    values, vectors = np.linalg.eigh(H / (unit[:, :, None] * unit[:, None, :]))
    determined = values[:, 0] >= LEAST_EIGENVALUE_RATIO * values[:, -1]
    along = np.einsum("ni,nij->nj", g / unit, vectors)[determined]
    return np.asarray((along**2 / values[determined]).sum(1))
