"""The descent of `flight_chain`, compiled: Gauss-Newton with Levenberg's damping and biweight frames, on plain arrays.

One descent takes some ten steps of a few small matrices each, and a throw is fitted some sixty times while its contacts are
looked for. Around the same kernels, Python would take half of the time.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...model.compiled import compiled, inner
from .chain_solver import MAX_LINK_SIZE, Stages, empty_stages, solve_chain
from .flight_kernels import (
    ChainMotion,
    FrameInformation,
    ImpactEquations,
    PoseArrays,
    VertexImpacts,
    apply_step,
    empty_motion,
    impact_equations,
    normal_equations,
    propagate,
    residuals,
)
from .turning import spin_rate_of

Array = NDArray[np.float64]

CUTOFF_SIGMAS = 4.685
"""Frames beyond this many sigmas (rms of the six numbers, in units of the error model) have no weight: Tukey's biweight."""
MEDIAN_RMS = 0.944
"""Median of the root mean square of six unit normals."""
PRIOR_NUMBERS = 12.0
"""Weight of the frames' stated sigmas, in numbers whose errors are as stated: a few frames do not overrule them."""
CONTACT_SIGMA_M = 2e-5
"""Standard deviation [m] of a single contact about the table's height: a stiff die of a few grams is indented by some 0.01 mm."""
LARGEST_STEP = 1e5
"""A step larger than this in any parameter (SI) leaves all that a die can do: its spin reaches some 1e3 rad/s."""
DAMPING_TRIALS = 12
"""Attempts, with ten times the damping each, to find a step that does not raise the cost."""
FIRST_DAMPING, LEAST_DAMPING, LEAST_TRIAL_DAMPING = 1e-6, 1e-12, 1e-9
"""Levenberg's damping at the first step; the least after steps that went well; and the least after one that did not."""
LOOSE_STEPS = 3
"""First steps, over which the cutoff is widened so that frames far off a first guess are drawn in."""
LOOSE_FACTOR = 3.0
"""Least factor on the cutoff over those steps."""
SLOW_RATE = 0.5
"""Steps that shrink by a larger factor than this are extrapolated."""
SLOWEST_RATE = 0.95
"""Steps that shrink by a larger factor than this are not extrapolated: that would be more than twenty steps at once."""
CONVERGED_COST = 1e-2
"""Gain [squared sigmas] of a step below which the fit has converged."""
CONVERGED_SHARE = 1e-4
"""The same as a share of the cost; the smaller of both counts."""
ORDER_SHARE = 1e-6
"""Least time between two links, in frames."""


class ChainData(NamedTuple):
    """What a chain is fitted to."""

    poses: PoseArrays
    information: FrameInformation
    information_share: float
    """Share of the first whitened number in it."""
    is_open: NDArray[np.bool_]
    """(N,) links behind which the state is free."""
    impacts: VertexImpacts
    constant_sigma: Array
    """(c,) prior standard deviations of what all flights share: errors of the clip, and last the table's height if there is an
    impact."""
    lever_sigma: Array
    """(N,) tolerance [rad/s] of each impact's spin."""
    spacing_s: float
    """Usual time between frames."""
    parameters: int
    """Number of unknowns."""


class ChainValues(NamedTuple):
    """The unknowns of a chain, changed in place."""

    first: Array
    """(14,) packed."""
    times_s: Array
    """(N,) instants of the links."""
    jumps: Array
    """(N, 6) Δv, Δω at joined links."""
    free: Array
    """(N, 14) packed states behind open links."""
    constants: Array
    """(c,)."""


class FrameErrors(NamedTuple):
    """The error model of single frames, as the descent needs it."""

    variance: Array
    """(6,) of a single whitened number."""
    share: Array
    """(6,) weights of the whitened numbers."""


class ChainTrajectory(NamedTuple):
    """The motion that the unknowns give, and the residuals of the frames about it, to be filled."""

    cuts: NDArray[np.int64]
    """(N + 2,) rows of each flight."""
    motion: ChainMotion
    residual: Array
    """(n, 6) whitened."""
    impacts: ImpactEquations


@compiled
def empty_trajectory(frames: int, links: int, impacts: int) -> ChainTrajectory:
    """Of so many frames, links and vertex impacts."""
    motion = empty_motion(links)
    equations = ImpactEquations(
        np.zeros((impacts, 4, 12)), np.zeros((impacts, 4, MAX_LINK_SIZE)), np.zeros((impacts, 4))
    )
    return ChainTrajectory(np.zeros(links + 2, np.int64), motion, np.empty((frames, 6)), equations)


@compiled(nogil=True)
def follow_chain(data: ChainData, values: ChainValues, out: ChainTrajectory) -> None:
    """Fill the trajectory of a chain."""
    poses = data.poses
    cuts, motion, residual, equations = out
    propagate(
        values.first, values.times_s, values.jumps, data.is_open, values.free, poses.gravity, poses.turning, motion
    )
    n, links, struck = len(poses.time_s), len(values.times_s), len(data.impacts.link)
    cuts[0], cuts[links + 1] = 0, n
    for k in range(links):
        low, high = 0, n
        while low < high:  # the number of frames up to the link
            middle = (low + high) // 2
            if poses.time_s[middle] <= values.times_s[k]:
                low = middle + 1
            else:
                high = middle
        cuts[k + 1] = low
    shared = values.constants[: len(values.constants) - (1 if struck > 0 else 0)]
    residuals(poses, shared, cuts, motion.states, residual)
    for s in range(struck):
        for i in range(4):
            for j in range(MAX_LINK_SIZE):
                equations.by_link[s, i, j] = 0.0
    table_m = values.constants[len(values.constants) - 1] if struck > 0 else 0.0
    impact_equations(motion.ends, values.jumps, data.impacts, table_m, CONTACT_SIGMA_M, data.lever_sigma, equations)


@inner
def _fill_squares(residual: Array, variance: Array, out: Array) -> None:
    """(n,) mean of each frame's six squared whitened residuals, each over its expected one."""
    for k in range(len(residual)):
        total = 0.0
        for i in range(6):
            total += residual[k, i] * residual[k, i] / variance[i]
        out[k] = total / 6.0


@inner
def _median(values: Array, begin: int, end: int, room: Array) -> float:
    """Of values[begin:end], by selection in `room`."""
    n = end - begin
    for k in range(n):
        room[k] = values[begin + k]
    upper = _selected(room, n, n // 2)
    if n % 2 == 1:
        return upper
    lower = room[0]
    for k in range(n // 2):  # selection leaves the smaller ones in front
        lower = max(lower, room[k])
    return 0.5 * (lower + upper)


@inner
def _selected(room: Array, n: int, rank: int) -> float:
    """The value of that rank among the first n (Hoare's selection); what is smaller stands before it then."""
    low, high = 0, n - 1
    while low < high:
        pivot = room[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while room[i] < pivot:
                i += 1
            while pivot < room[j]:
                j -= 1
            if i <= j:
                room[i], room[j] = room[j], room[i]
                i += 1
                j -= 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return float(room[rank])


@inner
def _white_scale(squares: Array, parameters: int, room: Array) -> float:
    """σ from the median frame, corrected for the fitted parameters, and drawn to 1 if the frames are few."""
    numbers = 6.0 * len(squares)
    free = max(numbers - parameters, 0.0)
    typical = _median(squares, 0, len(squares), room) / (MEDIAN_RMS * MEDIAN_RMS) * numbers / max(free, 6.0)
    return sqrt(max((free * typical + PRIOR_NUMBERS) / (free + PRIOR_NUMBERS), 1e-24))


@inner
def _fill_weights(
    squares: Array, cuts: NDArray[np.int64], loose: bool, by_flight: bool, weights: Array, room: Array
) -> None:
    """Biweights. While the cutoff is `loose`, it is as far off as the group of frames is, and LOOSE_FACTOR at least: of each
    flight, or of all frames."""
    groups = len(cuts) - 1 if by_flight else 1
    for group in range(groups):
        begin, end = (cuts[group], cuts[group + 1]) if by_flight else (0, len(squares))
        factor = 1.0
        if loose and end > begin:
            factor = max(LOOSE_FACTOR, sqrt(_median(squares, begin, end, room)) / MEDIAN_RMS)
        for k in range(begin, end):
            ratio = sqrt(squares[k]) / (CUTOFF_SIGMAS * factor)
            weights[k] = (1.0 - ratio * ratio) ** 2 if ratio < 1.0 else 0.0


@inner
def _cost_of_priors_and_impacts(data: ChainData, values: ChainValues, impacts: ImpactEquations) -> float:
    total = 0.0
    for j in range(len(values.constants)):
        total += (values.constants[j] / data.constant_sigma[j]) ** 2
    for s in range(len(impacts.violation)):
        for i in range(4):
            total += impacts.violation[s, i] ** 2
    return total


@inner
def _weighted_cost(
    data: ChainData, values: ChainValues, trajectory: ChainTrajectory, weights: Array, share: Array
) -> float:
    """Sum of weighted squared sigmas of frames, priors and impacts."""
    total = _cost_of_priors_and_impacts(data, values, trajectory.impacts)
    for k in range(len(weights)):
        if weights[k] > 0.0:
            frame = 0.0
            for i in range(6):
                frame += trajectory.residual[k, i] ** 2 * share[i]
            total += weights[k] * frame
    return total


@compiled(nogil=True)
def robust_cost(data: ChainData, values: ChainValues, trajectory: ChainTrajectory, errors: FrameErrors) -> float:
    """The same with Tukey's loss for frames (`FlightChain.cost`). What lies beyond the cutoff counts in full: errors that stay
    for many frames, for which the others count less, explain no such frame."""
    variance, share = errors
    total, usual = _cost_of_priors_and_impacts(data, values, trajectory.impacts), 0.0
    for i in range(6):
        usual += variance[i] * share[i] / 6.0
    for k in range(len(trajectory.residual)):
        square = 0.0
        for i in range(6):
            square += trajectory.residual[k, i] ** 2 / variance[i]
        ratio = min(sqrt(square / 6.0) / CUTOFF_SIGMAS, 1.0)
        loss = 2.0 * CUTOFF_SIGMAS * CUTOFF_SIGMAS * (1.0 - (1.0 - ratio * ratio) ** 3)
        total += (usual if ratio < 1.0 else 1.0) * loss
    return total


@compiled(nogil=True)
def chain_equations(
    data: ChainData, values: ChainValues, trajectory: ChainTrajectory, weights: Array, share: Array, normal: Array,
    gradient: Array, stages: Stages,
) -> None:  # fmt: skip
    """Fill the normal equations of the flights (N + 1, d, d) and (N + 1, d), the priors included in those of the first, and the
    links between. An error model that is estimated on the way is white: all shares change by one factor."""
    size, change = normal.shape[1], share[0] / data.information_share
    scaled = np.empty(len(weights))
    for k in range(len(weights)):
        scaled[k] = change * weights[k]
    for flight in range(normal.shape[0]):
        for a in range(size):
            gradient[flight, a] = 0.0
            for b in range(size):
                normal[flight, a, b] = 0.0
    normal_equations(
        data.poses, data.information, trajectory.residual, scaled, trajectory.cuts, trajectory.motion.states, normal,
        gradient,
    )  # fmt: skip
    for j in range(len(values.constants)):
        information = 1.0 / (data.constant_sigma[j] * data.constant_sigma[j])
        normal[0, 12 + j, 12 + j] += information
        gradient[0, 12 + j] += values.constants[j] * information
    _fill_stages(data, values, trajectory, size, stages)


@inner
def _fill_stages(data: ChainData, values: ChainValues, trajectory: ChainTrajectory, size: int, stages: Stages) -> None:
    """The links as `chain_solver` needs them. What is zero in `stages` and stays so is not written."""
    sizes, by_state, by_link, impact_by_state, impact_by_link, violation = stages
    _, motion, _, impacts = trajectory
    turning = data.poses.turning
    for k in range(len(sizes)):
        for a in range(12, size):
            by_state[k, a, a] = 1.0
        if data.is_open[k]:
            sizes[k] = 12
            for a in range(12):
                by_link[k, a, a] = 1.0
            continue
        sizes[k] = 7
        for a in range(12):
            for b in range(12):
                by_state[k, a, b] = motion.transitions[k, a, b]
        # The velocity at the link changes with its instant only through gravity, which both sides share, and the spin only of a
        # body with several moments of inertia.
        before, behind = spin_rate_of(turning, motion.ends[k]), spin_rate_of(turning, motion.states[k + 1])
        for a in range(6):
            by_link[k, a, 0] = -values.jumps[k, a]
            by_link[k, 6 + a, 1 + a] = 1.0
        for a in range(3):
            by_link[k, 9 + a, 0] = before[a] - behind[a]
    for s in range(len(data.impacts.link)):
        k = data.impacts.link[s]
        for i in range(4):
            violation[k, i] = impacts.violation[s, i]
            for j in range(MAX_LINK_SIZE):
                impact_by_link[k, i, j] = impacts.by_link[s, i, j]
            for b in range(12):
                total = 0.0
                for a in range(12):
                    total += impacts.by_end[s, i, a] * motion.transitions[k, a, b]
                impact_by_state[k, i, b] = total
        impact_by_state[k, 0, size - 1] = -1.0 / CONTACT_SIGMA_M


@inner
def _step(values: ChainValues, data: ChainData, first: Array, changes: Array, times: float, out: ChainValues) -> None:
    """Fill the unknowns after so many times a step; links keep their order and move by half a frame at most."""
    links, size = len(values.times_s), len(first)
    change, link_changes = np.empty(12), np.empty((links, MAX_LINK_SIZE))
    for a in range(12):
        change[a] = times * first[a]
    for a in range(14):
        out.first[a] = values.first[a]
    for k in range(links):
        out.times_s[k] = values.times_s[k]
        for a in range(6):
            out.jumps[k, a] = values.jumps[k, a]
        for a in range(14):
            out.free[k, a] = values.free[k, a]
        for a in range(MAX_LINK_SIZE):
            link_changes[k, a] = times * changes[k, a]
    apply_step(out.first, out.times_s, out.jumps, data.is_open, out.free, change, link_changes, 0.5 * data.spacing_s)
    for k in range(1, links):
        out.times_s[k] = max(out.times_s[k], out.times_s[k - 1] + ORDER_SHARE * data.spacing_s)
    for j in range(12, size):
        out.constants[j - 12] = values.constants[j - 12] + times * first[j]


@inner
def _copy(source: ChainValues, target: ChainValues) -> None:
    for a in range(14):
        target.first[a] = source.first[a]
    for k in range(len(source.times_s)):
        target.times_s[k] = source.times_s[k]
        for a in range(6):
            target.jumps[k, a] = source.jumps[k, a]
        for a in range(14):
            target.free[k, a] = source.free[k, a]
    for j in range(len(source.constants)):
        target.constants[j] = source.constants[j]


@inner
def _largest(first: Array, changes: Array) -> float:
    largest = 0.0
    for a in range(len(first)):
        largest = max(largest, abs(first[a]))
    for k in range(len(changes)):
        for a in range(changes.shape[1]):
            largest = max(largest, abs(changes[k, a]))
    return largest


@inner
def _remaining_steps(before: float, last: float) -> float:
    """Sum of the steps still to come, in units of the last one, if each is shorter than the one before by one factor: frames near
    the cutoff are drawn in or released little by little. 1 if the steps do not shrink that way."""
    # The gain of a step goes as its square.
    rate = sqrt(last / before) if 0.0 < last < before else 0.0
    return 1.0 / (1.0 - rate) if SLOW_RATE < rate < SLOWEST_RATE else 1.0


@compiled(nogil=True)
def descend(
    data: ChainData, values: ChainValues, trajectory: ChainTrajectory, errors: FrameErrors, estimate_scale: bool,
    by_flight: bool, steps: int, weights: Array,
) -> None:  # fmt: skip
    """Step until no step gains any more. `values`, `trajectory` and `weights` (n,) are those of the end; so are `errors` if
    their scale is estimated, as that of a white error.

    A first guess may leave all frames far off; the cutoff is therefore widened over the first steps, by one factor for all frames
    or flight by flight. The latter recovers a flight that begins so far off that it would be left without frames; but if another
    contact lies within a flight, one factor for all frames does better."""
    variance, share = errors
    n, links, struck = len(weights), len(values.times_s), len(data.impacts.link)
    size = 12 + len(values.constants)
    trial, further = _room_for(values), _room_for(values)
    trial_trajectory, further_trajectory = empty_trajectory(n, links, struck), empty_trajectory(n, links, struck)
    normal, gradient = np.empty((links + 1, size, size)), np.empty((links + 1, size))
    stages = empty_stages(links, size)
    first, changes = np.zeros(size), np.zeros((links, MAX_LINK_SIZE))
    squares, room, white = np.empty(n), np.empty(n), np.ones(6)
    now, now_trajectory = values, trajectory
    follow_chain(data, now, now_trajectory)
    damping, gain_before, gain = FIRST_DAMPING, 0.0, 0.0
    for step in range(steps):
        if estimate_scale:
            _fill_squares(now_trajectory.residual, white, squares)
            scale = _white_scale(squares, data.parameters, room)
            for i in range(6):
                variance[i], share[i] = scale * scale, 1.0 / (scale * scale)
        _fill_squares(now_trajectory.residual, variance, squares)
        _fill_weights(squares, now_trajectory.cuts, step < LOOSE_STEPS, by_flight, weights, room)
        cost = _weighted_cost(data, now, now_trajectory, weights, share)
        chain_equations(data, now, now_trajectory, weights, share, normal, gradient, stages)
        found, new = False, cost
        for _ in range(DAMPING_TRIALS):
            first, changes = solve_chain(normal, gradient, stages, damping)
            if _largest(first, changes) < LARGEST_STEP:
                _step(now, data, first, changes, 1.0, trial)
                follow_chain(data, trial, trial_trajectory)
                new = _weighted_cost(data, trial, trial_trajectory, weights, share)
                if new <= cost * (1.0 + 1e-12):
                    found = True
                    break
            damping = max(damping * 10.0, LEAST_TRIAL_DAMPING)
        if not found:
            break
        gain_before, gain = gain, cost - new
        times = _remaining_steps(gain_before, gain) if step > LOOSE_STEPS else 1.0
        took_more = False
        if times > 1.0:
            _step(now, data, first, changes, times, further)
            follow_chain(data, further, further_trajectory)
            ahead = robust_cost(data, further, further_trajectory, errors)
            took_more = ahead < robust_cost(data, trial, trial_trajectory, errors)
        if took_more:
            now, further = further, now
            now_trajectory, further_trajectory = further_trajectory, now_trajectory
            gain = 0.0  # the next step shows no rate
        else:
            now, trial = trial, now
            now_trajectory, trial_trajectory = trial_trajectory, now_trajectory
        damping = max(damping * 0.1, LEAST_DAMPING)
        if cost - new < min(CONVERGED_COST, CONVERGED_SHARE * cost) and step > LOOSE_STEPS:
            break
    _copy(now, values)
    follow_chain(data, values, trajectory)


@inner
def _room_for(values: ChainValues) -> ChainValues:
    links = len(values.times_s)
    return ChainValues(
        np.empty(14), np.empty(links), np.empty((links, 6)), np.empty((links, 14)), np.empty(len(values.constants))
    )
