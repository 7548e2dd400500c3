"""Steps of a film's clock, found from the motion: frames that are missing, and frames that are there twice.

In flight the centre follows a parabola and the spin is constant, or changes as Euler's equations say, so a die in flight is a
clock. Between two neighbouring frames the motion before (x_b with covariance C_b, from the W frames before) and the motion behind
(x_a, C_a, from the W frames behind, at their times as filmed) are compared. If all times behind are late by τ, the states at the
gap t obey

    d(τ) = x_a(t) ⊖ x_b(t + τ) = 0,     C(τ) = C_a + T(τ) C_b T(τ)ᵀ,     χ²(τ) = dᵀ C⁻¹ d     (12 numbers),

with T the transition matrix of free flight. A missing frame moves the die along its velocity and turns it along its spin, and
leaves both as they are. An impact does the opposite: it joins the two motions in one pose, at an instant within the gap, and
changes velocity and spin. Four hypotheses are compared:

    none             τ = 0
    step             τ = n intervals, n a whole number
    fraction         τ free
    impact           the poses agree at an instant in the gap (6 numbers, one of them spent on the instant)
    impact and step  the same with the frames behind late by n intervals

The size of the frames' errors is not known beforehand. It is estimated from the residuals Q of both windows about their own
motions, with the frames' stated sigmas worth PRIOR_NUMBERS numbers; integrated over it, the log-likelihood of a hypothesis is

    L = -½ ν ln(PRIOR_NUMBERS + Q + χ²),     ν = PRIOR_NUMBERS + degrees of freedom of Q + 12,

less ½ ln(numbers) for each parameter that it adds (Schwarz, Ann. Stat. 6, 461, 1978). A step is found if it gains more than
MIN_EVIDENCE plus the logarithm of the number of gaps and shifts that were tried. Where a window contains another step or an
impact, Q is large and nothing gains much; windows of several lengths are tried, and the step with the largest gain is
corrected before the next is sought.

Frames that repeat the picture before them are left out of the motion. In their gap a step has to be decided in any case: either
the clock ran on (the picture is frozen), or it stood (the frames are there twice). It is decided by a gain of LEAST_DECISION
over the second best, at an impact as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from ...model.engine.asymmetric import TorqueFree
from ...model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between
from ...model.throw import Turning, turns_in_flight
from ..flights import WeightedPoses, fit_states, left_jacobians, spin_rates, unpacked

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

WINDOWS = (4, 8, 16)
"""Frames on either side of a gap. The shortest finds steps six frames apart; the longest a slow die's, and steps of less than a
frame."""
PRIOR_NUMBERS = 12.0
"""Weight of the frames' stated sigmas, in numbers whose errors are as stated: two frames do not overrule them."""
MIN_EVIDENCE = 12.0
"""Least gain of a step in log-likelihood beyond the number of trials: odds of 1e5 for each film. Errors of neighbouring frames
are correlated, which costs some of it."""
DOUBT_EVIDENCE = 12.0
"""Further gain that a fraction, or a step at an impact, needs: nothing is corrected by them, and correlated errors and contacts
close together look like them."""
USUAL_RESIDUALS = 2.0
"""Most that the residuals of both windows may be above the film's usual ones [variance ratio] at such a gap: with more, an
impact lies in a window, and not in the gap."""
LEAST_DECISION = 7.0
"""Least gain in log-likelihood, odds of a thousand, of the best shift over all others in a gap whose pictures are repeated."""
MAX_MISSING = 32
"""Most frames that are missing in one gap: over more of them an impact is likely."""
MAX_REPEATED = 8
"""Most frames in a row that are there twice."""
MAX_AT_IMPACT = 4
"""Most frames that are missing in a gap with an impact: motions before and after it that lie farther apart meet by chance."""
FAR_SIGMA = 0.05
"""Largest standard error [frame intervals] of a step over more frames than MAX_AT_IMPACT: on a badly tracked clip, poses turned
the wrong way once agreed with a step of 13.96 ± 0.08 intervals."""
NEWTON_STEPS = 5
"""Steps towards the free estimate of a step: the motion is nearly straight over most gaps."""
NEAR_INTEGER = 0.2
"""Largest distance of the free estimate of a step from a whole number of intervals: the error of poses beside it, and of the
frame rate over the longest gap."""
MAX_OFF_SIGMAS = 4.0
"""The same in its standard errors, beyond LEAST_OFF."""
LEAST_OFF = 0.02
"""Distance [frame intervals] from a whole number that correlated errors of neighbouring poses explain."""
CLEAR_INTERVALS = 0.12
"""Largest standard error of a step [frame intervals], from positions and rotations alone, with which it is sought: a die that
hardly moves is no clock."""
LEAST_FRACTION = 0.1
"""Least step [frame intervals] that is reported as a fraction: less is what exposure and marks do to a pose."""
INSTANTS = 7
"""Instants in a gap at which an impact is tried."""
IMPACT_NUMBERS = 7
"""Numbers that an impact adds: its instant and the jumps of velocity and spin."""


class StepKind(Enum):
    """What a gap between two frames is."""

    WHOLE = "whole"
    """The clock steps by a whole number of intervals: frames are missing, or there twice."""
    RUNS_ON = "runs on"
    """Pictures in the gap are repeated, and the clock runs on."""
    FRACTION = "fraction"
    """The clock steps by a part of an interval."""
    UNDECIDED = "undecided"
    """Frames seem to be missing where an impact lies in the gap, or pictures are repeated and the motion does not show whether
    the clock ran on."""


@dataclass(frozen=True)
class TimeStep:
    """A step of the clock between two frames."""

    kind: StepKind
    before: int
    """Number of the last frame before it."""
    after: int
    """Number of the first frame behind it that was used."""
    intervals: float
    """Frame intervals by which the times of all frames behind increase: what is likeliest, whether or not it is certain."""
    measured_intervals: float
    """The free estimate of the same."""
    sigma_intervals: float
    """Its standard error."""
    evidence: float
    """Gain in log-likelihood over the next best hypothesis."""

    @property
    def is_certain(self) -> bool:
        """Whether the times are known."""
        return self.kind in (StepKind.WHOLE, StepKind.RUNS_ON)


def find_time_steps(
    observations: WeightedPoses, frames: Rows, interval_s: float, repeated: Rows | None = None
) -> tuple[TimeStep, ...]:
    """The steps of the clock among poses of frames in flight, in order, and what became of gaps with repeated pictures.

    `frames` (n,) are the frames' numbers; `observations.time_s` their times as filmed, and `interval_s` the interval of the
    camera's clock. `repeated` (m,) are the numbers of frames, not among these, that repeat the picture before them."""
    repeated = np.zeros(0, np.int64) if repeated is None else repeated
    search = _Search(observations, frames, interval_s, repeated)
    found: list[TimeStep] = []
    while best := search.best():
        found += best
        search.settle(best)
    return tuple(sorted(found, key=lambda step: step.before))


class _Search:
    """The gaps of a track with the evidence for a step in each, kept up to date while steps are corrected."""

    def __init__(self, observations: WeightedPoses, frames: Rows, interval_s: float, repeated: Rows) -> None:
        self._observations, self._frames, self._interval_s = observations, frames, interval_s
        n = len(observations)
        inside = np.searchsorted(repeated, frames)
        self._repeated = np.diff(inside, prepend=inside[:1])
        """(n,) number of repeated pictures in the gap before each frame."""
        self._steps: dict[int, list[TimeStep | None]] = {window: [None] * n for window in WINDOWS}
        """For each window, the step before each frame."""
        self._is_done = np.zeros(n, bool)
        self._usual_variance: dict[int, float] = {}
        """Usual variance of the frames' errors in units of the stated one, for each window."""
        self._threshold = MIN_EVIDENCE + np.log(max(n, 1) * (MAX_MISSING + MAX_REPEATED))
        for window in WINDOWS:
            self._update(np.arange(n), window)

    def best(self) -> list[TimeStep]:
        """The step with the most evidence, and others that do not lie in a window of its or of each other."""
        candidates = [
            (_rank(step), row, window)
            for window, steps in self._steps.items()
            for row, step in enumerate(steps)
            if step is not None and not self._is_done[row]
        ]
        chosen: list[tuple[int, int]] = []
        for _, row, window in sorted(candidates, reverse=True):
            if all(abs(row - other) >= max(window, its_window) for other, its_window in chosen):
                chosen.append((row, window))
        steps = [step for row, window in chosen if (step := self._steps[window][row]) is not None]
        # While there are certain steps, an uncertain one may be the effect of one of them.
        certain = [step for step in steps if step.is_certain]
        return certain or steps[:1]

    def settle(self, steps: list[TimeStep]) -> None:
        """Correct the times behind certain steps, and leave uncertain ones."""
        rows = np.searchsorted(self._frames, [step.after for step in steps])
        self._is_done[rows] = True
        time_s = self._observations.time_s.copy()
        for step, row in zip(steps, rows, strict=True):
            if step.is_certain:
                time_s[row:] += step.intervals * self._interval_s
        self._observations = replace(self._observations, time_s=time_s)
        corrected = np.array(
            [row for step, row in zip(steps, rows, strict=True) if step.is_certain and step.intervals], int
        )
        uncertain = np.array([row for step, row in zip(steps, rows, strict=True) if not step.is_certain], int)
        # What is left beside an uncertain step is the same step, less well placed.
        self._is_done |= self._is_near(uncertain, min(WINDOWS)) & (self._repeated == 0)
        for window in WINDOWS:
            self._update(np.flatnonzero(self._is_near(corrected, window) & ~self._is_done), window)

    def _is_near(self, rows: Rows, distance: int) -> NDArray[np.bool_]:
        """(n,) rows at most so far from some rows."""
        apart = np.abs(np.arange(len(self._frames))[:, None] - rows)
        return np.asarray((apart <= distance).any(axis=1))

    def _update(self, rows: Rows, window: int) -> None:
        """Judge the gaps before some rows anew, with a window of so many frames on either side."""
        steps = self._steps[window]
        for row in rows:
            steps[row] = None
        inside = rows[(rows >= window) & (rows <= len(self._frames) - window)]
        if not len(inside):
            return
        gaps = _Gaps.at(self._observations, inside, window)
        usual = self._usual_variance.setdefault(window, float(np.median(gaps.variance_factor)))
        # No shift leaves squares below zero: most gaps need no trial.
        most = gaps.likelihood(np.zeros(len(inside)), 1) - gaps.likelihood(gaps.step_chi2(0.0), 0)
        tried = np.flatnonzero((most > self._threshold) | (self._repeated[inside] > 0))
        judged = self._judged(gaps.some(tried), inside[tried], USUAL_RESIDUALS * usual)
        for row, step in zip(inside[tried], judged, strict=True):
            steps[row] = step

    def _judged(self, gaps: _Gaps, rows: Rows, most_variance: float) -> list[TimeStep | None]:
        """What each gap shows; None where that is no step."""
        found: list[TimeStep | None] = []
        if not len(rows):
            return found
        trial = _Trials.of(gaps, self._interval_s, max(1, int(self._repeated.max())))
        for k, row in enumerate(rows):
            ends = int(self._frames[row - 1]), int(self._frames[row])
            count = int(self._repeated[row])
            if count:
                found.append(trial.repeated_gap(k, count, ends))
                continue
            step = trial.whole_step(k, self._threshold, ends)
            if step is None and gaps.variance_factor[k] < most_variance:
                step = trial.doubtful_step(k, self._threshold + DOUBT_EVIDENCE, ends)
            found.append(step)
        return found


def _rank(step: TimeStep) -> tuple[bool, float]:
    return step.is_certain, step.evidence


@dataclass(frozen=True, eq=False)
class _Trials:
    """The hypotheses on gaps (k,), with their log-likelihoods."""

    shifts: NDArray[np.int64]
    """(s, k) whole steps [intervals] that were tried, each once in a gap."""
    step: Array
    """(s, k) steps by these; the one by 0 is the hypothesis that there is none. Minus infinity where another row has it."""
    impact: Array
    """(s, k) an impact and a step; the one by 0 is an impact alone. Minus infinity where it was not tried."""
    none_row: int
    """Row of the step by 0."""
    late: NDArray[np.int64]
    """(k,) likeliest step, above 0, at an impact."""
    beside_late: Array
    """(k,) an impact and a step half an interval off that, on the likelier side."""
    free: Array
    """(k,) a step of any size."""
    measured: Array
    """(k,) the free estimate of the step [intervals]."""
    sigma: Array
    """(k,) its standard error [intervals]."""
    is_clear: NDArray[np.bool_]
    """(k,) whether the die moves enough to show a step."""

    @staticmethod
    def of(gaps: _Gaps, interval_s: float, most_repeated: int) -> _Trials:
        measured_s, sigma_s, pose_sigma_s = gaps.free_step(interval_s)
        usual = np.arange(-most_repeated, MAX_AT_IMPACT + 1)
        nearest = np.rint(np.clip(measured_s / interval_s, -MAX_REPEATED, MAX_MISSING)).astype(int)
        shifts = np.concatenate([np.repeat(usual[:, None], len(nearest), 1), nearest[None]])
        step = np.stack([gaps.likelihood(gaps.step_chi2(n * interval_s), 1) for n in shifts])
        none = most_repeated
        step[none] = gaps.likelihood(gaps.step_chi2(0.0), 0)
        step[-1, (usual[0] <= nearest) & (nearest <= usual[-1])] = -np.inf
        impact = np.full(step.shape, -np.inf)
        for row, n in enumerate(usual):
            impact[row] = gaps.likelihood(gaps.impact_chi2(n * interval_s), IMPACT_NUMBERS + int(n != 0))
        free = gaps.likelihood(gaps.step_chi2(measured_s), 1)
        late = 1 + np.argmax(impact[none + 1 : -1], axis=0)
        between = [
            gaps.likelihood(gaps.impact_chi2((late + part) * interval_s), IMPACT_NUMBERS + 1) for part in (-0.5, 0.5)
        ]
        is_clear = pose_sigma_s < CLEAR_INTERVALS * interval_s
        return _Trials(
            shifts, step, impact, none, late, np.max(between, axis=0), free, measured_s / interval_s, sigma_s / interval_s,
            is_clear,
        )  # fmt: skip

    def whole_step(self, k: int, threshold: float, ends: tuple[int, int]) -> TimeStep | None:
        """The step by whole intervals in gap k between frames `ends`; None without one."""
        best = int(np.argmax(self.step[:, k]))
        whole, measured, sigma = int(self.shifts[best, k]), float(self.measured[k]), float(self.sigma[k])
        gain = float(self.step[best, k] - max(self.step[self.none_row, k], self.impact[self.none_row, k]))
        near = abs(measured - whole) < min(NEAR_INTEGER, LEAST_OFF + MAX_OFF_SIGMAS * sigma)
        # A wrong pose may lie on the path some frames ahead by chance, the more so the less well that is known.
        known = whole <= MAX_AT_IMPACT or sigma < FAR_SIGMA
        if not (self.is_clear[k] and whole != 0 and gain > threshold and near and known):
            return None
        return TimeStep(StepKind.WHOLE, *ends, whole, measured, sigma, gain)

    def doubtful_step(self, k: int, threshold: float, ends: tuple[int, int]) -> TimeStep | None:
        """What gap k between frames `ends` shows that cannot be corrected; None without that."""
        none, late = self.none_row, int(self.late[k])
        measured, sigma = float(self.measured[k]), float(self.sigma[k])
        partly = float(self.free[k] - max(self.step[none, k], self.impact[none, k]))
        if not self.is_clear[k]:
            return None
        if partly > threshold and min(abs(measured), abs(measured - round(measured))) > LEAST_FRACTION:
            return TimeStep(StepKind.FRACTION, *ends, measured, measured, sigma, partly)
        others = max(float(self.step[:, k].max()), float(self.impact[none, k]), float(self.beside_late[k]))
        at_impact = float(self.impact[none + late, k]) - others
        if at_impact > threshold:
            return TimeStep(StepKind.UNDECIDED, *ends, late, measured, sigma, at_impact)
        return None

    def repeated_gap(self, k: int, count: int, ends: tuple[int, int]) -> TimeStep:
        """What became of the clock in gap k between frames `ends`, in which `count` pictures are repeated."""
        possible = np.flatnonzero(self.shifts[:, k] >= -count)
        either = np.maximum(self.step, self.impact)[possible, k]
        order = np.argsort(either)
        whole, gain = int(self.shifts[possible[order[-1]], k]), float(either[order[-1]] - either[order[-2]])
        measured, sigma = float(self.measured[k]), float(self.sigma[k])
        if not self.is_clear[k] or gain < LEAST_DECISION:
            return TimeStep(StepKind.UNDECIDED, *ends, whole, measured, sigma, max(gain, 0.0))
        return TimeStep(StepKind.WHOLE if whole else StepKind.RUNS_ON, *ends, whole, measured, sigma, gain)


@dataclass(frozen=True, eq=False)
class _Gaps:
    """Motions before and behind gaps between frames (k,), each from a window of frames of its own."""

    from_s: Array
    """(k,) time of the last frame before each gap."""
    to_s: Array
    """(k,) time as filmed of the first frame behind it."""
    states_before: Array
    """(k, 14) packed, each at a time of its own."""
    covariances_before: Array
    states_behind: Array
    covariances_behind: Array
    """(k, 12, 12)."""
    residual_chi2: Array
    """(k,) sum of squares of both windows about their own motions."""
    numbers: float
    """Measured numbers of both windows."""
    gravity_m_s2: float
    turning: Turning

    @staticmethod
    def at(observations: WeightedPoses, rows: Rows, window: int) -> _Gaps:
        """The gaps before some rows (k,), with that many frames on either side."""
        before = [np.arange(row - window, row) for row in rows]
        behind = [np.arange(row, row + window) for row in rows]
        states, covariances, chi2 = fit_states(observations, before + behind)
        k = len(rows)
        return _Gaps(
            observations.time_s[rows - 1], observations.time_s[rows], states[:k], covariances[:k], states[k:],
            covariances[k:], chi2[:k] + chi2[k:], 12.0 * window, observations.gravity_m_s2, observations.turning,
        )  # fmt: skip

    def some(self, which: Rows) -> _Gaps:
        """Some of the gaps."""
        return _Gaps(
            self.from_s[which], self.to_s[which], self.states_before[which], self.covariances_before[which],
            self.states_behind[which], self.covariances_behind[which], self.residual_chi2[which], self.numbers, self.gravity_m_s2,
            self.turning,
        )  # fmt: skip

    def likelihood(self, chi2: Array, parameters: int) -> Array:
        """(k,) log-likelihood of a hypothesis that leaves the squares `chi2` (k,) between both motions."""
        free = PRIOR_NUMBERS + (self.numbers - 24.0) + 12.0
        penalty = 0.5 * parameters * np.log(self.numbers)
        return np.asarray(-0.5 * free * np.log(PRIOR_NUMBERS + self.residual_chi2 + chi2) - penalty)

    def step_chi2(self, late_s: Array | float) -> Array:
        """χ² (k,) for frames behind that are later than filmed by `late_s`."""
        difference, covariance, _ = self._mismatch(late_s)
        return _squares(difference, covariance)

    def free_step(self, interval_s: float) -> tuple[Array, Array, Array]:
        """The step (k,) [s] that leaves the least χ², its standard error, and what that would be from positions and
        rotations alone."""
        late = np.zeros(len(self.to_s))
        bound = interval_s * np.array([-MAX_REPEATED, MAX_MISSING])
        for _ in range(NEWTON_STEPS):
            difference, covariance, rate = self._mismatch(late)
            weighted = np.linalg.solve(covariance, rate[:, :, None])[:, :, 0]
            own = np.maximum((rate * weighted).sum(1), 1e-300)
            late = np.clip(late + (weighted * difference).sum(1) / own, *bound)
        scale = self.variance_factor
        from_pose = np.maximum(_squares(rate[:, :6], covariance[:, :6, :6]), 1e-300)
        return late, np.sqrt(scale / own), np.sqrt(scale / from_pose)

    def _mismatch(self, late_s: Array | float) -> tuple[Array, Array, Array]:
        """How far the motion behind is off the motion before if it is later by `late_s` (k, 12), the covariance of that
        (k, 12, 12), and the change of the motion before with time (k, 12)."""
        late = np.broadcast_to(np.asarray(late_s, float), self.to_s.shape)
        before, C_before = self._before(self.to_s + late)
        behind, C_behind = self._behind(self.to_s)
        rate = np.zeros((len(late), 12))
        rate[:, :3], rate[:, 3:6], rate[:, 8] = before[:, 8:11], before[:, 11:14], -self.gravity_m_s2
        if isinstance(self.turning, TorqueFree):
            rate[:, 9:] = spin_rates(self.turning, before)
        return _difference(behind, before), C_before + C_behind, rate

    def _before(self, times_s: Array) -> tuple[Array, Array]:
        """The motions before the gaps at times (k,), with their covariances."""
        return _moved(self.states_before, self.covariances_before, times_s, self.gravity_m_s2, self.turning)

    def _behind(self, times_s: Array) -> tuple[Array, Array]:
        """The motions behind them."""
        return _moved(self.states_behind, self.covariances_behind, times_s, self.gravity_m_s2, self.turning)

    def impact_chi2(self, late_s: Array | float) -> Array:
        """χ² (k,) for an impact in the gap, at the instant that makes it least, and frames behind that are later than
        filmed by `late_s`."""
        late_s = np.broadcast_to(np.asarray(late_s, float), self.to_s.shape)
        least = np.full(len(self.to_s), np.inf)
        for share in np.linspace(0.0, 1.0, INSTANTS):
            instant = self.from_s + share * (self.to_s + late_s - self.from_s)
            before, C_before = self._before(instant)
            behind, C_behind = self._behind(instant - late_s)
            difference = _difference(behind, before)[:, :6]
            least = np.minimum(least, _squares(difference, (C_before + C_behind)[:, :6, :6]))
        return least

    @property
    def variance_factor(self) -> Array:
        """(k,) variance of the frames' errors in units of the stated one, 1 at the least."""
        return np.maximum(1.0, (PRIOR_NUMBERS + self.residual_chi2) / (PRIOR_NUMBERS + self.numbers - 24.0))


def _squares(vectors: Array, covariances: Array) -> Array:
    """(k,) vᵀ C⁻¹ v."""
    return np.asarray((vectors * np.linalg.solve(covariances, vectors[:, :, None])[:, :, 0]).sum(1))


def _moved(
    states: Array, covariances: Array, times_s: Array, gravity_m_s2: float, turning: Turning
) -> tuple[Array, Array]:
    """Packed states (k, 14) and their covariances (k, 12, 12) in free flight at other times (k,)."""
    tau = (times_s - states[:, 0])[:, None]
    turn = tau * states[:, 11:14]
    out = states.copy()
    out[:, 0] = times_s
    out[:, 1:4] += tau * states[:, 8:11]
    out[:, 3] -= 0.5 * gravity_m_s2 * tau[:, 0] ** 2
    out[:, 4:8] = quat_multiply(quat_from_rotvec(turn), states[:, 4:8])
    out[:, 10] -= gravity_m_s2 * tau[:, 0]
    T = np.tile(np.eye(12), (len(states), 1, 1))
    T[:, 0:3, 6:9] = tau[:, :, None] * np.eye(3)
    T[:, 3:6, 3:6] = matrix_from_quat(quat_from_rotvec(turn))
    T[:, 3:6, 9:12] = tau[:, :, None] * left_jacobians(turn)
    if isinstance(turning, TorqueFree):
        for k, state in enumerate(states):
            turns = turns_in_flight(turning, unpacked(state), tau[k])
            out[k, 4:8], out[k, 11:14] = turns.quaternions[0], turns.omegas_rad_s[0]
            attitude = np.ix_([k], [3, 4, 5, 9, 10, 11], [3, 4, 5, 9, 10, 11])
            T[attitude] = turns.transitions
    return out, T @ covariances @ np.swapaxes(T, 1, 2)


def _difference(states: Array, others: Array) -> Array:
    """(k, 12) from `others` to `states`, packed (k, 14) at the same instants: position, rotation vector, velocity, spin."""
    turn = rotation_between(others[:, 4:8], states[:, 4:8])
    moved, rates = states[:, 1:4] - others[:, 1:4], states[:, 8:14] - others[:, 8:14]
    return np.concatenate([moved, turn, rates], axis=1)
