"""The end of a throw: the die no longer flies but rolls or lies on the table.

In flight the centre of the die falls with g. Once the table supports the die, in lasting contact or in impacts too small to be
separated, its lowest point stays at one height and its centre falls, on average, much more slowly. The last frames over which
both hold show no flight, and none is fitted to them.

A die that nearly rests may fly for long with its lowest point hardly off the table: where it rocks from one corner to another, a
hop of 0.1 mm lasts for 30 frames. A die that tips over falls nearly as fast as one in flight; the spin distinguishes them. A
contact that carries the share ν of the weight at a horizontal distance d from the centre causes

    a = (1 - ν) g   and   α = ν m g d/J;      while it lasts, ν = J/(J + m d²) at least.

Flights that follow each other without an interval of support remain flights. So do frames of a die that tumbles too fast to stay
on the table: with the spin ω about a horizontal axis its centre, at the height h ≥ r, the inscribed radius, would have to
accelerate down with ω² h, and a table does not pull.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter

from ...model.die import Die, inner_vertices
from ...model.engine.asymmetric import TorqueFree
from ...model.rotations import continuous_sign, matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between
from ...model.throw import Flight, Throw
from ..flights import WeightedPoses, fit_flights, pose_jacobian, unpacked
from ..track import LOST, Track
from .flight_segmentation import contact_reach_m

Array = NDArray[np.float64]

MIN_LEVEL_FRAMES = 12
"""Fewest frames that show a constant height."""
FRAMES_LEFT_TO_FLIGHT = 3
"""Level frames left to the last flight: they determine it behind the last impact."""
LEVEL_SHARE = 0.01
"""Deviation of the lowest point from its constant height, as a share of an edge, besides three sigmas: smaller impacts are part
of coming to rest."""
LEVEL_SIGMAS = 3.0
"""Sigmas that are added to it."""
MEDIAN_EFFICIENCY = 0.64
"""Efficiency of a median relative to a mean, for normal errors."""
HOPPING_CHI2 = 25.0
"""Squared sigmas off the table from which the lowest point is surely not on it: the die hops."""
LOW_SHARE = 0.15
"""Height, as a share of an edge, below which frames are tested for support by their accelerations: hops of 2 mm last for 40 ms,
and edges alone err by as much in distance."""
MEDIAN_FRAMES = 5
"""Frames of the running median of the height, against the depth error of single frames."""
HOP_DURATIONS = 1.5
"""Durations of a hop that deviates no further, 2 √(2h/g): a longer interval is neither a hop nor the end of one."""
FIRST_WINDOW = 8
"""Frames of the shortest window that is tested for free fall: good poses show it within 5 ms."""
HOP_WINDOW = 5
"""The same where heights that err much seem level: at 250 frames per second a die that hops flies for five frames."""
LONGER_WINDOW = 1.5
"""Ratio of the lengths of successive windows: of a hop of 24 frames, windows of 16 may not show the fall, and windows of 32 reach
beyond it."""
MAX_WINDOW_FRAMES = 128
"""Frames that are used of a window, or up to twice as many, evenly spread: more of a film far faster than the die have correlated
errors, and would count as more information than they are."""
RATE_WINDOW_S = 5e-3
"""Duration [s] over which velocity and spin of a supported die are means, or two frame intervals if these last longer: long
against the errors of poses, and short against the time in which a die rolls from one face to the next."""
GAP_WINDOWS = 2
"""Longest interval between two flights, in windows of FIRST_WINDOW or more frames, that is not taken for support: flights shorter
than a window are not detected."""
LONGEST_WINDOW_S = 0.1
"""Duration [s] beyond which a window is no hop of a die that nearly rests."""
MAX_FLIGHT_CHI2 = 16.0
"""Most squared sigmas between frames in flight and free motion: four numbers exceed that in three cases of a thousand."""
LEAST_SUPPORT_CHI2 = 9.0
"""Least squared sigmas between free motion and the motion of a supported die for a window to distinguish them."""
DECIDING_SHARE = 0.25
"""Share of the windows that must distinguish them. A window across an impact follows neither motion, and with hops of ten frames
half of the windows of eight are such; longer ones are all."""
RESTING_SHARE = 0.5
"""The same for the windows behind the flights, if the table supports the die from there on: none of them is across an impact."""
NEARER_SHARE = 0.25
"""Frames show a flight if their chi-square from free motion is below this share of that between the two: they are less than half
as far, in sigmas, from the one as from the other."""
LEVER_SAMPLES = 9
"""Distances of a supporting contact from the centre that are evaluated."""
SUPPORTED_SHARE = 0.5
"""Share of g below which the centre does not fall freely: half-way between a die in flight and one at rest."""
FALL_SIGMAS = 3.0
"""Standard errors by which the acceleration must differ from g."""
TUMBLING_G = 2.0
"""Downward acceleration, in g, that a die's spin would take to stay on the table, beyond which it flies: with little more than
one it hops, too low to be seen."""
SLIDING_G = 2.0
"""Acceleration across the table, in g, beyond which no friction pushes a die: it hops."""
LONGER_SPAN = 4.0 / 3.0
"""Ratio of the spans of neighbouring frames from which a hop is measured."""
LEAST_ASIDE = 1e-3
"""Way across the table by a unit of height below which it counts as none: of a camera above."""
TURN_RAD = 0.2
"""Turn [rad] of a die that just stays on the table over the frames between which its spin is taken: some times the error of a
pose."""
TOUCHING_SHARE = 0.01
"""Height above the lowest vertex, as a share of an edge, up to which a vertex touches the table."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SupportedMotion(Flight):
    """The motion of a die that the table supports: the poses of its frames, and straight lines between."""

    times_s: Array
    """(n,) of the frames."""
    positions_m: Array
    """(n, 3)."""
    quaternions: Array
    """(n, 4) wxyz."""

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        times = np.clip(np.asarray(times_s, float), self.times_s[0], self.times_s[-1])
        signed = continuous_sign(self.quaternions)
        positions = np.stack([np.interp(times, self.times_s, column) for column in self.positions_m.T], axis=1)
        quaternions = np.stack([np.interp(times, self.times_s, column) for column in signed.T], axis=1)
        return positions, quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)

    def rates(self, times_s: ArrayLike) -> Array:
        """Velocities [m/s] and angular velocities [rad/s] (n, 6), world axes, at times (n,) [s]: means over RATE_WINDOW_S
        about each. Before the first frame and after the last the die does not move."""
        times, first_s, last_s = np.asarray(times_s, float), self.times_s[0], self.times_s[-1]
        interval_s = float(np.median(np.diff(self.times_s))) if len(self.times_s) > 1 else 0.0
        half_s = max(0.5 * RATE_WINDOW_S, interval_s)
        begin_s, end_s = (np.clip(times + offset_s, first_s, last_s) for offset_s in (-half_s, half_s))
        (here_m, here), (there_m, there) = self.poses(begin_s), self.poses(end_s)
        moves = (times >= first_s) & (times <= last_s) & (end_s > begin_s)
        passed_s = np.where(moves, end_s - begin_s, np.inf)[:, None]
        return np.asarray(np.hstack([there_m - here_m, rotation_between(here, there)]) / passed_s)


# --- where the flights end ---------------------------------------------------------------------------------------------


def first_low_row(observations: WeightedPoses, die: Die) -> int:
    """The first of the last rows over which the die stays near the table (LOW_SHARE); the number of rows if it does not."""
    deviation = _deviation_from_level(observations, die)
    if deviation is None:
        return len(observations)
    return _first_of_last_rows(deviation < LOW_SHARE * die.solid.edge_m)


def first_supported_row(observations: WeightedPoses, die: Die) -> int:
    """The first of the last rows over which the table supports the die; the number of rows if it flies to the end."""
    n, deviation = len(observations), _deviation_from_level(observations, die)
    if deviation is None:
        return n
    low = _first_of_last_rows(deviation < LOW_SHARE * die.solid.edge_m)
    first, is_supported = _row_behind_flights(observations, low, die, FIRST_WINDOW)
    if not is_supported:
        behind_flights, first = first, _first_level_row(observations, deviation, die)
        if first == n or first < behind_flights:
            return n
        # Hops that the errors of heights hide, and whose mean is no fall, may yet show that the die flies.
        behind_flights, is_supported = _row_behind_flights(observations, first, die, HOP_WINDOW)
        if behind_flights > first:
            if not is_supported:
                return n
            first = behind_flights
    elif not _is_supported(observations, slice(first, n)):
        # Errors that neighbouring frames share make windows of a flight look unlike one. Where the whole range does not show
        # support either, a flight errs less than its heights do.
        return n
    if _tumbles(observations.rows(slice(first, n)), die):
        return n
    # The last impact may lie a frame behind the first level frame: the frames that show it are left to the flight.
    return min(first + FRAMES_LEFT_TO_FLIGHT, n)


def _first_level_row(observations: WeightedPoses, deviation: Array, die: Die) -> int:
    """The first of the last rows over which the lowest point stays at its height for longer than a hop, and the centre does not
    fall freely; the number of rows if there are none."""
    n = len(observations)
    information = np.swapaxes(observations.whitener, 1, 2) @ observations.whitener
    sigma = np.sqrt(np.linalg.inv(information)[:, 2, 2])
    allowed = LEVEL_SHARE * die.solid.edge_m + LEVEL_SIGMAS * sigma / np.sqrt(MEDIAN_EFFICIENCY * MEDIAN_FRAMES)
    first = _first_of_last_rows(deviation <= allowed)
    hop_s = 2.0 * np.sqrt(2.0 * float(np.median(allowed[first:])) / observations.gravity_m_s2) if first < n else 0.0
    duration_s = observations.time_s[-1] - observations.time_s[first] if first < n else 0.0
    if first == n or duration_s < HOP_DURATIONS * hop_s or not _is_supported(observations, slice(first, n)):
        return n
    return first


def _deviation_from_level(observations: WeightedPoses, die: Die) -> Array | None:
    """(n,) [m] distance of the lowest point, by a running median, from its height at the end; None if that is not the table's."""
    if len(observations) < MIN_LEVEL_FRAMES:
        return None
    heights = lowest_heights_m(die, observations.position_m, observations.quaternion)
    level = float(np.median(heights[-MIN_LEVEL_FRAMES:]))
    if abs(level) > contact_reach_m(die):
        return None
    return np.asarray(np.abs(median_filter(heights, MEDIAN_FRAMES, mode="nearest") - level))


def _first_of_last_rows(holds: NDArray[np.bool_]) -> int:
    """The first of the last rows over which a condition holds."""
    off = np.flatnonzero(~holds)
    return int(off[-1]) + 1 if len(off) else 0


def _row_behind_flights(observations: WeightedPoses, first: int, die: Die, window: int) -> tuple[int, bool]:
    """The row behind the flights that follow from row `first`, itself if the die does not fly there, 0 if the frames do not
    decide; and whether these, enough of them behind the flights, show that the table supports the die from there on.

    Windows of `window` frames, then longer ones, are tested until enough of them (DECIDING_SHARE) distinguish flight from
    support. Windows longer yet may follow flights farther: what neighbouring frames err by in common hides a flight from short
    ones. Shorter intervals between two flights are ignored. A die whose centre of mass is not its centroid is not tested: its
    centroid does not fall freely."""
    n = len(observations) - first if die.is_nearly_centred else 0
    end = 0
    deciding: list[tuple[int, NDArray[np.int64], NDArray[np.bool_]]] = []
    while window <= n and observations.time_s[first + window - 1] - observations.time_s[first] < LONGEST_WINDOW_S:
        begins, free_chi2, support_chi2 = _accelerations(
            observations.rows(slice(first, len(observations))), window, die
        )
        distinguishes = support_chi2 > LEAST_SUPPORT_CHI2
        if deciding or np.mean(distinguishes) > DECIDING_SHARE:
            deciding.append((GAP_WINDOWS * max(window, FIRST_WINDOW), begins, distinguishes))
            limit = np.minimum(MAX_FLIGHT_CHI2, NEARER_SHARE * support_chi2)
            for k in begins[distinguishes & (free_chi2 < limit)].tolist():
                if k <= end + deciding[0][0]:
                    end = max(end, k + window)
        window = round(LONGER_WINDOW * window)
    is_supported = any(
        n - end > gap and distinguishes[begins >= end].mean() > RESTING_SHARE for gap, begins, distinguishes in deciding
    )
    return first + end if is_supported or end > 0 else 0, is_supported


def _accelerations(observations: WeightedPoses, window: int, die: Die) -> tuple[NDArray[np.int64], Array, Array]:
    """Test of windows of `window` frames for free motion: the first row (w,) of each, the chi-square (w,) of fall and angular
    acceleration from free motion, and the least chi-square (w,) if the table supported the die.

    Nothing is assumed to push the die sideways: what is seen across the line of sight then determines how it falls, whatever the
    error in distance.
    """
    begins = np.arange(0, len(observations) - window + 1, max(window // FIRST_WINDOW, 1))
    rows = begins[:, None] + np.arange(0, window, max(window // MAX_WINDOW_FRAMES, 1))
    tau = observations.time_s[rows] - observations.time_s[rows[:, rows.shape[1] // 2, None]]
    # Unknowns: the state (12), downward acceleration (1) and angular acceleration (3) in excess of free motion.
    A = np.zeros((*rows.shape, 6, 16))
    departure, A[..., :12] = _about_free_motion(observations, rows, tau)
    A[..., 2, 12] = -0.5 * tau**2
    A[..., 3:, 13:] = 0.5 * tau[..., None, None] ** 2 * np.eye(3)
    W = observations.whitener[rows]
    A = (W @ A).reshape(len(rows), -1, 16)
    y = (W @ departure[..., None]).reshape(len(rows), -1)
    inverse = np.linalg.inv(np.einsum("wip,wiq->wpq", A, A))
    found = np.einsum("wpq,wiq,wi->wp", inverse, A, y)
    variance = ((y - np.einsum("wip,wp->wi", A, found)) ** 2).sum(1) / (A.shape[1] - 16)
    C, excess = inverse[:, 12:, 12:] * variance[:, None, None], found[:, 12:]
    chi2 = np.einsum("wi,wi->w", excess, np.linalg.solve(C, excess[..., None])[..., 0])
    return begins, chi2, _least_support_chi2(C, die, observations.gravity_m_s2)


def _about_free_motion(observations: WeightedPoses, rows: NDArray[np.int64], tau: Array) -> tuple[Array, Array]:
    """Departures (w, k, 6) of the poses of windows of rows (w, k) from free motions, and their derivatives (w, k, 6, 12) by the
    states of these; `tau` (w, k) [s] is the time since the middle of each window.

    A spherical top turns evenly: the motion may be any, as that of a die which falls past the middle frame without velocity. Any
    other body has its own free motion in each window."""
    if isinstance(observations.turning, TorqueFree):
        states, _ = fit_flights(observations, list(rows))
        departures, derivatives = np.empty((*rows.shape, 6)), np.empty((*rows.shape, 6, 12))
        for k, state in enumerate(states):
            flight, times_s = observations.flight(unpacked(state)), observations.time_s[rows[k]]
            positions, quaternions = flight.poses(times_s)
            departures[k, :, :3] = observations.position_m[rows[k]] - positions
            departures[k, :, 3:] = rotation_between(quaternions, observations.quaternion[rows[k]])
            derivatives[k] = pose_jacobian(flight, times_s)
        return departures, derivatives
    middle = rows[:, rows.shape[1] // 2, None]
    displacement = observations.position_m[rows] - observations.position_m[middle]
    displacement[..., 2] += 0.5 * observations.gravity_m_s2 * tau**2
    rotation = rotation_between(observations.quaternion[middle], observations.quaternion[rows])
    by_pose = np.broadcast_to(np.eye(6), (*rows.shape, 6, 6))
    by_state = np.concatenate([by_pose, tau[..., None, None] * np.eye(6)], axis=3)
    return np.concatenate([displacement, rotation], axis=2), by_state


def _least_support_chi2(C: Array, die: Die, gravity_m_s2: float) -> Array:
    """(w,) least squared sigmas by which a supporting contact changes fall and angular acceleration, whose covariances are C (w,
    4, 4)."""
    longest = float(np.sqrt(die.solid.circumradius**2 - die.solid.inradius**2))
    lever = np.linspace(0.0, longest, LEVER_SAMPLES)
    # Of a body with several moments the largest, which gives way least.
    inertia_kg_m2 = float(np.linalg.eigvalsh(die.tensor_kg_m2)[-1])
    share = inertia_kg_m2 / (inertia_kg_m2 + die.mass_kg * lever**2)
    angular = share * die.mass_kg * gravity_m_s2 * lever / inertia_kg_m2
    largest_variance = np.linalg.eigvalsh(C[:, 1:, 1:])[:, -1:]
    return np.asarray(((share * gravity_m_s2) ** 2 / C[:, :1, 0] + angular**2 / largest_variance).min(1))


def _is_supported(observations: WeightedPoses, rows: slice) -> bool:
    """Whether the centre clearly does not fall freely over these frames, but much more slowly."""
    t, z = observations.time_s[rows] - observations.time_s[rows].mean(), observations.position_m[rows, 2]
    basis = np.stack([np.ones_like(t), t, 0.5 * t * t], axis=1)
    values, *_ = np.linalg.lstsq(basis, z, rcond=None)
    inverse = np.linalg.inv(basis.T @ basis)
    variance = float(((z - basis @ values) ** 2).sum()) / max(len(t) - 3, 1)
    sigma = float(np.sqrt(variance * inverse[2, 2]))
    gravity_m_s2 = observations.gravity_m_s2
    return bool(values[2] > -SUPPORTED_SHARE * gravity_m_s2 and values[2] + gravity_m_s2 > FALL_SIGMAS * sigma)


def _tumbles(observations: WeightedPoses, die: Die) -> bool:
    """Whether the die turns, in most frames, about a horizontal axis too fast to stay on the table (TUMBLING_G)."""
    t, q = observations.time_s, observations.quaternion
    fastest_rad_s = np.sqrt(TUMBLING_G * observations.gravity_m_s2 / die.solid.inradius)
    stride = max(1, round(TURN_RAD / (fastest_rad_s * float(np.median(np.diff(t))))))
    if len(t) <= stride:
        return False
    turns = rotation_between(q[:-stride], q[stride:])
    return bool(np.median(np.hypot(turns[:, 0], turns[:, 1]) / (t[stride:] - t[:-stride])) > fastest_rad_s)


# --- frames on the table -----------------------------------------------------------------------------------------------


def on_table(track: Track, rows: NDArray[np.int64], die: Die, table_m: float, table_sigma_m: float) -> Track:
    """The track with the poses of its frames `rows`, over which the table supports the die, conditioned on the contact.

    The lowest point is on the table, whose height `table_m` is known to `table_sigma_m`, or hops by LEVEL_SHARE at most, taken
    for two sigmas, or, with one sigma, anywhere within a hop that its path shows (`_hop_heights_m`). That determines the height,
    which one camera hardly sees, since it is distance. A frame too far off (HOPPING_CHI2) stays as it is."""
    p, q, C = track.position_m[rows], track.quaternion[rows], track.covariance[rows]
    corners = matrix_from_quat(q) @ inner_vertices(die.solid, die.corner_radius_m).T
    low = np.argmin(corners[:, 2], axis=1)
    x, y, z = np.moveaxis(np.take_along_axis(corners, low[:, None, None], axis=2)[..., 0], 1, 0)
    height = p[:, 2] + z - die.corner_radius_m - table_m
    # ẑ·(δp + δθ × r)
    row = np.stack([np.zeros_like(x), np.zeros_like(x), np.ones_like(x), y, -x, np.zeros_like(x)], axis=1)
    with_height = np.einsum("nij,nj->ni", C, row)
    of_height = (row * with_height).sum(1)
    # How poses move with the height that they are given, and what else leaves them open.
    by_height = with_height / of_height[:, None]
    apart = C - by_height[:, :, None] * with_height[:, None, :]
    level = p - height[:, None] * by_height[:, :3]
    hop = _hop_heights_m(
        track.time_s[rows], level, by_height, apart, LEVEL_SHARE * die.solid.edge_m, track.gravity_m_s2
    )
    sigma_m = np.hypot(0.5 * np.maximum(LEVEL_SHARE * die.solid.edge_m, hop), table_sigma_m)
    variance, off = of_height + sigma_m**2, height - 0.5 * hop
    gain = np.where(off**2 < HOPPING_CHI2 * variance, 1.0 / variance, 0.0)[:, None] * with_height
    change = -gain * off[:, None]
    position, quaternion, covariance = track.position_m.copy(), track.quaternion.copy(), track.covariance.copy()
    position[rows] += change[:, :3]
    quaternion[rows] = quat_multiply(quat_from_rotvec(change[:, 3:]), q)
    covariance[rows] = C - gain[:, :, None] * with_height[:, None, :]
    return replace(track, position_m=position, quaternion=quaternion, covariance=covariance)


def _hop_heights_m(
    times_s: Array, level_m: Array, by_height: Array, apart: Array, least_m: float, gravity_m_s2: float
) -> Array:
    """(n,) [m] heights of the hops, if higher than `least_m`, that frames are part of; 0 where they show none.

    A hop that is taken for a die on the table seems to slide away from the camera and back. A hop of the duration 2τ is g τ²/2
    high, and seems to slide by s times as much, where the positions `level_m` (n, 3) on the table move sideways by s with each
    unit of height (`by_height` (n, 6)): no friction pushes a die that fast where s is large, and where it is small the distance
    is known without. Of each frame the place between those w before and w behind is taken away, and of the first and the last
    that on the line of two others, with errors `apart` (n, 6, 6)."""
    n, hop, w = len(times_s), np.zeros(len(times_s)), 1
    squared = np.maximum((by_height[:, :2] ** 2).sum(1), LEAST_ASIDE**2)
    away = -by_height[:, :2] / np.sqrt(squared)[:, None]
    variance = np.einsum("ni,nij,nj->n", away, apart[:, :2, :2], away)
    while 2 * w < n:
        inner = np.arange(w, n - w)
        here = np.r_[inner, 0, n - 1]
        one, other = np.r_[inner - w, w, n - 1 - w], np.r_[inner + w, 2 * w, n - 1 - 2 * w]
        share = (times_s[here] - times_s[one]) / (times_s[other] - times_s[one])
        place = (1.0 - share)[:, None] * level_m[one, :2] + share[:, None] * level_m[other, :2]
        slid = ((level_m[here, :2] - place) * away[here]).sum(1)
        sigma = np.sqrt(variance[here] + (1.0 - share) ** 2 * variance[one] + share**2 * variance[other])
        pushed = (
            0.5 * SLIDING_G * gravity_m_s2 * np.abs((times_s[here] - times_s[one]) * (times_s[here] - times_s[other]))
        )
        height = slid / np.sqrt(squared[here])
        is_short = np.abs(times_s[other] - times_s[here]) < 0.5 * LONGEST_WINDOW_S
        shows = is_short & (height > least_m) & (slid > pushed + LEVEL_SIGMAS * sigma)
        for k, high_m in zip(here[shows], height[shows], strict=True):
            part = slice(max(k - w + 1, 0), k + w)
            hop[part] = np.maximum(hop[part], high_m)
        if not is_short.any():
            break
        w = max(w + 1, round(LONGER_SPAN * w))
    return hop


def flights_only(throw: Throw) -> Throw:
    """The flights of a measured throw, without the supported motion at its end."""
    if not isinstance(throw.flights[-1], SupportedMotion):
        return throw
    return Throw(throw.flights[:-1], throw.impacts[:-1])


def frames_in_flight(track: Track, throw: Throw) -> Track:
    """The track with the frames behind the last flight of a measured throw as lost: what a model of flights may be fitted to. The
    poses stay as they are."""
    behind = track.tracked & (track.time_s > flights_only(throw).flights[-1].end_s)
    return replace(track, status=np.where(behind, LOST, track.status)) if behind.any() else track


def lowest_heights_m(die: Die, positions_m: Array, quaternions: Array) -> Array:
    """(n,) [m] heights above z = 0 of the lowest points of a die at positions (n, 3) and orientations (n, 4)."""
    corners = matrix_from_quat(quaternions) @ inner_vertices(die.solid, die.corner_radius_m).T
    return np.asarray(corners[:, 2].min(1) + positions_m[:, 2] - die.corner_radius_m)


def resting_vertices(die: Die, rotation: Array) -> tuple[int, ...]:
    """The vertices that touch the table with the die in this orientation (3, 3), the lowest first (TOUCHING_SHARE)."""
    heights = (rotation @ die.solid.vertices.T)[2]
    order = np.argsort(heights)
    return tuple(int(i) for i in order if heights[i] - heights[order[0]] < TOUCHING_SHARE * die.solid.edge_m)
