"""States of a die on the other side of an impact, to be compared with a picture that its flight does not explain.

The motion before an impact, or of a tracker that runs backwards the one after it, says which corners may have touched the table
and when, but not the restitution. Smooth impacts with several are tried, close enough to each other for a refinement to find the
die from one of them.

Where none of these is right, after several impacts at once, the motion behind them follows from the poses that each of three
pictures in a row shows by itself: those of a die in flight lie on a parabola and turn evenly."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import angle_between
from ...model.throw import Flight, State, turning_of
from ..picture import View, edges_cost, region_costs
from ..pose import Pose, same_picture, seen_distance_m
from .acceptance import BOUNCE_REACH, HEIGHT_SIGMAS, NEW_FLIGHT_RAD, NEW_FLIGHT_REACH
from .even_rotation import even_rotation
from .motion_filter import (
    FIRST_POSES_RAD,
    FIRST_POSES_REACH,
    MotionEstimate,
    innovation_squared,
    lowest_m,
    same_flight_chi2,
)

Array = NDArray[np.float64]

TRIAL_RESTITUTIONS = (0.15, 0.5, 0.9)
"""Least, likeliest and largest restitution of the impacts that are tried."""
LEAST_TRIALS = 3
"""Least number of restitutions between these."""
TRIAL_SPACING_RAD = 0.15
"""Largest difference between the turns over a frame interval that neighbouring trials lead to: refinements correct half of it.
Backwards, and at low frame rates, that takes more trials: what the die did before hangs on the reciprocal of the restitution."""
TRIAL_SHARES = 2
"""Least number of shares of a frame interval that are left after the impacts that are tried."""
TOUCH_SHARE = 0.12
"""Height, as a share of an edge, below which a corner may touch the table between two frames."""
NEAR_TABLE_SHARE = 0.35
"""Distance of a corner from the table, in edges, at which it may touch it, at low frame rates: the die is known that well."""
WINDOW_SAMPLES = 6000
"""Pixels of the window on which poses refined on edges are compared."""
POSE_VARIANCE_FACTOR = 4.0
"""Factor on the covariance of a pose that starts a motion: twice its standard errors."""
EVEN_REACH = 0.07
"""Departure of poses from a parabola as the camera sees it, in units of the die's reach, beyond which they are those of no
flight."""
EVEN_CHANCE = 0.005
"""Probability with which orientations on three pictures turn evenly by chance. With θ the largest departure, one of them comes
near enough to one of N labellings of an even rotation with the probability N θ³/6π, and N spins lead through the two before."""
SINK_FACTOR = 1.5
"""Factor on a corner's descent over a frame interval, for the error of its velocity."""


def beyond_impacts(die: Die, last: State, time_s: float, gravity_m_s2: float) -> Iterator[State]:
    """States of the die on the other side of an impact between the last frame and this one, which lies after it or, of a tracker
    that runs backwards, before it, likely ones first: smooth impacts with several restitutions, at several instants, on each
    corner that touches the table there."""
    dt = time_s - last.time_s
    found: list[tuple[float, State]] = []
    _, likeliest, _ = _trial_range(dt > 0.0)
    corners = last.rotation @ die.solid.vertices.T
    heights = corners[2] + last.position_m[2]
    sink = np.minimum((last.velocity_m_s[2] + np.cross(last.omega_rad_s, corners.T)[:, 2]) * dt, 0.0)
    for i in np.flatnonzero(heights + SINK_FACTOR * sink < TOUCH_SHARE * die.solid.edge_m).tolist():
        _, turn_rad = _stopping_impulse(die, last, i, dt)
        shares = max(TRIAL_SHARES, int(np.ceil((1.0 + likeliest) * turn_rad / (2.0 * TRIAL_SPACING_RAD))))
        for share in (np.arange(shares) + 0.5) / shares:
            touch = _flight(die, last, gravity_m_s2).at(last.time_s + (1.0 - share) * dt)
            if shares == TRIAL_SHARES or _touches(die, touch, i):
                found += _beyond_impact(die, touch, i, dt, share, gravity_m_s2)
    for _, state in sorted(found, key=lambda trial: abs(np.log(trial[0] / likeliest))):
        yield state


def _beyond_impact(
    die: Die, touch: State, corner: int, dt: float, share: float, gravity_m_s2: float
) -> Iterator[tuple[float, State]]:
    """States at the end of a share of the interval that begins with an impact of one corner, with the ratio of its normal
    velocities."""
    impulse, turn_rad = _stopping_impulse(die, touch, corner, dt)
    if impulse * dt <= 0.0:
        return
    spin = _spin_by_push(die, touch, corner)
    least, _, largest = _trial_range(dt > 0.0)
    number = max(LEAST_TRIALS, int(np.ceil((largest - least) * turn_rad / TRIAL_SPACING_RAD)))
    for ratio in np.linspace(least, largest, number):
        velocity = touch.velocity_m_s + np.array([0.0, 0.0, (1.0 + ratio) * impulse / die.mass_kg])
        omega = touch.omega_rad_s + (1.0 + ratio) * impulse * spin
        after = replace(touch, velocity_m_s=velocity, omega_rad_s=omega)
        yield float(ratio), _flight(die, after, gravity_m_s2).at(touch.time_s + share * dt)


def _flight(die: Die, state: State, gravity_m_s2: float) -> Flight:
    return Flight(state, np.inf, gravity_m_s2=gravity_m_s2, turning=turning_of(die))


def _spin_by_push(die: Die, state: State, corner: int) -> Array:
    """(3,) [rad/s] by which a vertical impulse of 1 N s on a corner changes the spin."""
    lever = np.cross(state.rotation @ die.solid.vertices[corner], [0.0, 0.0, 1.0])
    return np.asarray(state.rotation @ np.linalg.solve(die.tensor_kg_m2, state.rotation.T @ lever))


def _stopping_impulse(die: Die, state: State, corner: int, dt: float) -> tuple[float, float]:
    """The upward impulse [N s] that takes the normal velocity of a corner on the table, and the angle [rad] by which it turns the
    die over a frame interval."""
    arm = state.rotation @ die.solid.vertices[corner]
    spin = _spin_by_push(die, state, corner)
    normal = float(state.velocity_m_s[2] + np.cross(state.omega_rad_s, arm)[2])
    impulse = -normal / (1.0 / die.mass_kg + float(np.cross(spin, arm)[2]))
    return impulse, abs(impulse * dt) * float(np.linalg.norm(spin))


def _touches(die: Die, state: State, corner: int) -> bool:
    """Whether a corner may touch the table: about as low as the table, and as the lowest."""
    heights = (state.rotation @ die.solid.vertices.T)[2] + state.position_m[2]
    edge = die.solid.edge_m
    return bool(abs(heights[corner]) < NEAR_TABLE_SHARE * edge and heights[corner] < heights.min() + TOUCH_SHARE * edge)


def _trial_range(forwards: bool) -> Array:
    """Least, likeliest and largest ratio of a corner's normal velocity on the other side of an impact to that on this side,
    opposite: of restitutions, or backwards of their reciprocals."""
    restitutions = np.array(TRIAL_RESTITUTIONS)
    return restitutions if forwards else 1.0 / restitutions[::-1]


def different_rates(states: Iterable[State], dt: float) -> Array:
    """(n, 6) the velocities and spins of some states that turn the die differently over a time."""
    kept: list[Array] = []
    for state in states:
        rates = np.concatenate([state.velocity_m_s, state.omega_rad_s])
        if all(np.linalg.norm(rates[3:] - other[3:]) * abs(dt) > 0.5 * TRIAL_SPACING_RAD for other in kept):
            kept.append(rates)
    return np.array(kept) if kept else np.zeros((0, 6))


def costs_on_one_window(view: View, image: NDArray[np.float32], poses: list[Pose]) -> Array:
    """(n,) costs of poses refined on edges, all on one window: on its own a pose beside the die explains its picture well."""
    if not poses:
        return np.zeros(0)
    places, turns = np.array([pose.position_m for pose in poses]), np.array([pose.rotation for pose in poses])
    camera = view.camera
    about_m = view.die.solid.circumradius * np.array([*np.eye(3), *-np.eye(3)])
    px = camera.project(places[:, None] + about_m)
    px = px[np.isfinite(px).all(2)]
    if not len(px):
        return np.array([pose.cost for pose in poses])
    size = camera.width_px, camera.height_px
    x0, y0 = np.clip(px.min(0), 0, np.array(size) - 2).astype(int).tolist()
    x1, y1 = np.clip(px.max(0) + 1.0, (x0 + 2, y0 + 2), size).astype(int).tolist()
    first = image[0] if image.ndim == 3 else image
    costs, _ = region_costs(view, first, (x0, y0, x1, y1), places, turns, WINDOW_SAMPLES)
    return costs + np.array([edges_cost(pose.clear_share, 0.0) for pose in poses])


@dataclass(frozen=True, eq=False)
class MotionOfPoses:
    """A flight through poses of single pictures."""

    poses: tuple[Pose, ...]
    """One for each picture, labelled alike."""
    time_s: Array
    """(n,) instants of exposure."""
    motion: Array
    """(9,) position [m], velocity [m/s] and spin [rad/s] at the last of them."""
    covariance: Array
    """(6, 6) of position and velocity."""


def motion_of_poses(
    view: View, times_s: Array, candidates: list[list[Pose]], fastest_m_s: float
) -> MotionOfPoses | None:
    """The flight on which one of the candidate poses of each picture lies, at frame times (n,) [s], n >= 3. None if there is
    none, or another that leads to another pose. `fastest_m_s` is the speed that the die can have: single pictures leave the
    velocity along the line of sight open."""
    tolerance_rad = float(np.cbrt(6.0 * np.pi * EVEN_CHANCE) / len(view.symmetries) ** (2.0 / 3.0))
    found: MotionOfPoses | None = None
    for poses in sorted(product(*candidates), key=lambda some: sum(pose.cost for pose in some)):
        motion = _motion_through(view, times_s, poses, tolerance_rad, fastest_m_s)
        if motion is None:
            continue
        if found is None:
            found = motion
        elif not same_picture(view, _place(found.poses[-1]), _place(motion.poses[-1])):
            return None
    return found


def _place(pose: Pose) -> tuple[Array, Array]:
    """Position (3,) and rotation (3, 3)."""
    return pose.position_m, pose.rotation


def _motion_through(
    view: View, times_s: Array, poses: tuple[Pose, ...], tolerance_rad: float, fastest_m_s: float
) -> MotionOfPoses | None:
    """The flight through some poses at frame times (n,) [s]; None if they lie on none."""
    position_m = np.array([pose.position_m for pose in poses])
    time_s = times_s + view.exposure_delay_s(position_m)
    passed_s = time_s - time_s[-1]
    without_fall = position_m + 0.5 * view.gravity_m_s2 * passed_s[:, None] ** 2 * np.array([0.0, 0.0, 1.0])
    H, g = np.zeros((6, 6)), np.zeros(6)
    H[3:, 3:] = np.eye(3) / fastest_m_s**2
    for pose, dt, place in zip(poses, passed_s, without_fall, strict=True):
        if pose.covariance is None:
            return None
        J = np.hstack([np.eye(3), dt * np.eye(3)])
        information = np.linalg.inv(POSE_VARIANCE_FACTOR * pose.covariance[:3, :3])
        H += J.T @ information @ J
        g += J.T @ information @ place
    covariance = np.asarray(np.linalg.inv(H), float)
    fitted = covariance @ g
    off_m = without_fall - fitted[:3] - passed_s[:, None] * fitted[3:]
    seen_m = [seen_distance_m(view.rig, p, off, view.reach_m) for p, off in zip(position_m, off_m, strict=True)]
    if max(seen_m) > EVEN_REACH * view.reach_m:
        return None
    even = even_rotation(np.array([pose.rotation for pose in poses]), time_s, view.symmetries, tolerance_rad)
    if even is None:
        return None
    labelled = tuple(replace(pose, rotation=R) for pose, R in zip(poses, even[0], strict=True))
    return MotionOfPoses(labelled, time_s, np.concatenate([fitted, even[1]]), covariance)


def initial_covariance(view: View, pose: Pose, frame_s: float, reach: float, rad: float) -> Array:
    """Covariance (12, 12) of a motion whose velocities are guesses, with these standard deviations per frame interval, in
    circumradii and in radians."""
    P = np.zeros((12, 12))
    known = pose.covariance
    P[:6, :6] = POSE_VARIANCE_FACTOR * known if known is not None else 0.0
    P[6:9, 6:9] = np.eye(3) * (reach * view.reach_m / frame_s) ** 2
    P[9:, 9:] = np.eye(3) * (rad / frame_s) ** 2
    return P


def widest_sigma(P: Array, first: int) -> float:
    """The largest standard deviation of three numbers of a motion, from its covariance (12, 12). Predicted back to where they
    were known, variances cancel, and rounding may make them negative."""
    return float(np.sqrt(max(np.diag(P)[first : first + 3].max(), 0.0)))


def leaves_flight(view: View, pose: Pose, ahead: MotionEstimate, turned_share: float) -> bool:
    """Whether a pose lies farther from where its flight leads than that allows, and, where it is turned there, than the errors of
    both explain: `motion_filter.track_frames` decides by the same bounds."""
    predicted, R, P = ahead.x, ahead.rotation, ahead.P
    far_reach, far_rad = bounds_of_flight(is_high(view, predicted[:3], R, P))
    gone_m = seen_distance_m(view.rig, pose.position_m, pose.position_m - predicted[:3], view.reach_m)
    turned = float(angle_between(pose.rotation, R))
    if gone_m > far_reach * view.reach_m or turned > FIRST_POSES_RAD:
        return True
    if turned <= far_rad:
        return False
    off = innovation_squared(predicted, R, P, pose.position_m, pose.rotation, pose.H, view.settings)
    return bool(off >= turned_share * same_flight_chi2(ahead.clock[2]))


def bounds_of_flight(high: bool) -> tuple[float, float]:
    """How far a pose may lie from where a known flight leads [units of the reach, rad]: less near the table."""
    return (FIRST_POSES_REACH, FIRST_POSES_RAD) if high else (NEW_FLIGHT_REACH, NEW_FLIGHT_RAD)


def is_high(view: View, position_m: Array, rotation: Array, P: Array) -> bool:
    """Whether a die of a motion with covariance P (12, 12) is too high above the table for an impact since the frame before."""
    lowest = float(lowest_m(view.shape, position_m, rotation))
    return lowest - HEIGHT_SIGMAS * widest_sigma(P, 0) > BOUNCE_REACH * view.reach_m
