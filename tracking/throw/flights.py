"""One flight through the poses of its frames: exact motion, and errors that go together from frame to frame.

In flight the motion is a parabola and a constant angular velocity ω. With E = exp(ω τ) and left (world) increments of a
rotation, R_true = exp(δθ) R, a state changes its pose a time τ later by

    δp(τ) = δp + τ δv          δθ(τ) = E δθ + τ J(ω τ) δω          J: left Jacobian of SO(3).

**Errors.** A frame's six errors, whitened by the covariance that the frame states (z = C^-½ e), are taken as

    z_k = w_k + c_k + C_k^-½ L_k s,     Var w = σ²,   Var c = σ² a,   corr(c_j, c_k) = exp(-|t_j - t_k|/T),

with σ, a and T for each of the six (`ErrorModel`). w is the noise of the frame's own pixels. c is what shading, grain and
marks do while they move slowly over the edges: a first-order autoregression. L s is what errs alike on every frame of
the clip (`lean`), with s a few numbers that all flights share.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply
from ...model.throw import Flight, State
from . import flight_kernels as kernels

Array = NDArray[np.float64]

SLACK_POSITION_M, SLACK_ROTATION_RAD = 1.5e-5, 1.0e-3
"""Added to each frame's own sigma where nothing has measured yet what shading and marks do to a pose beyond its noise."""


AT_ONCE = 64
"""Groups whose frames are gathered at once: all of a long clip would take more memory than the clip's poses."""


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """How the frames' whitened errors compare with what the frames state, and how long they stay alike: six of each."""

    scale: Array
    """(6,) σ: factor on the frame's own sigma, for the white part."""
    wander: Array
    """(6,) a: variance of the slow part, in units of the white part's."""
    memory_s: Array
    """(6,) T: time after which the slow part has forgotten all but 1/e of itself."""

    @staticmethod
    def white(scale: float = 1.0) -> ErrorModel:
        """Frames that err each for itself, by so many times what they state."""
        return ErrorModel(np.full(6, scale), np.zeros(6), np.ones(6))

    @property
    def variance(self) -> Array:
        """(6,) of a single whitened error: σ² (1 + a)."""
        return self.scale**2 * (1.0 + self.wander)

    def slow_variance(self, spacing_s: float) -> Array:
        """(6,) of a single whitened error as it counts in a mean over many frames so far apart: its spectral density at
        frequency zero, σ² (1 + a (1 + φ)/(1 - φ)) with φ = exp(-spacing/T)."""
        keep = np.exp(-spacing_s / self.memory_s)
        return np.asarray(self.scale**2 * (1.0 + self.wander * (1.0 + keep) / (1.0 - keep)))


@dataclass(frozen=True, eq=False)
class Observations:
    """Poses of single frames, as the fits want them."""

    time_s: Array
    position_m: Array
    quaternion: Array
    whitener: Array
    """(n, 6, 6): W with WᵀW the inverse covariance."""
    lean: Array
    """(n, 6, m) change of the pose for each of m errors that the whole clip shares; m may be 0."""

    @staticmethod
    def from_poses(
        time_s: Array, position_m: Array, quaternion: Array, covariance: Array, *, slack: float = 1.0
    ) -> Observations:
        """Poses of frames (n,) with their covariance (n, 6, 6), slack added; where that is NaN, the usual slack alone."""
        most = np.diag([SLACK_POSITION_M**2] * 3 + [SLACK_ROTATION_RAD**2] * 3)
        known = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
        C = np.where(known[:, None, None], np.where(known[:, None, None], covariance, 0.0) + slack**2 * most, most)
        return Observations(time_s, position_m, quaternion, _whiteners(C), np.zeros((len(time_s), 6, 0)))

    def leaning(self, lean: Array) -> Observations:
        """The same frames with errors (n, 6, m) that the clip shares."""
        return replace(self, lean=np.ascontiguousarray(lean))

    def rows(self, which: NDArray[np.int64] | slice) -> Observations:
        """Some of the frames."""
        return Observations(
            self.time_s[which], self.position_m[which], self.quaternion[which], self.whitener[which], self.lean[which]
        )

    def __len__(self) -> int:
        return len(self.time_s)


def chain_misses(seen: Observations, cuts: NDArray[np.int64], states: Array, shared: Array) -> Array:
    """Whitened residuals (n, 6) of frames from the motions of flights, the shared errors (m,) taken out: rows cuts[k] to
    cuts[k + 1] belong to the packed state (14,) `states[k]`."""
    misses = np.empty((len(seen), 6))
    kernels.misses(*_arrays(seen), seen.lean, shared, cuts, states, misses)
    return misses


def informations(seen: Observations, share: Array) -> tuple[Array, Array]:
    """What frames say of their poses and of the shared errors, the six whitened numbers counting with their `share` (6,):
    information (n, 6 + m, 6 + m), and the (n, 6 + m, 6) that turn whitened residuals into pulls. Of no motion: fits of
    one share have it once."""
    own = 6 + seen.lean.shape[2]
    information, pulls = np.empty((len(seen), own, own)), np.empty((len(seen), own, 6))
    kernels.weigh(_arrays(seen)[3], seen.lean, share, information, pulls)
    return information, pulls


def chain_sums(
    seen: Observations,
    cuts: NDArray[np.int64],
    states: Array,
    misses: Array,
    weights: Array,
    told: tuple[Array, Array],
    size: int,
) -> tuple[Array, Array]:
    """Normal equations of each flight about its state: matrices (flights, size, size) of the twelve numbers of the state and
    the shared errors, and gradients (flights, size) of half the cost; what is beyond 12 + m stays zero. Frames count with
    their weight (n,), `told` are their `informations`."""
    normal, gradient = np.zeros((len(states), size, size)), np.zeros((len(states), size))
    kernels.sums(_arrays(seen)[0], *told, misses, weights, cuts, states, normal, gradient)
    return normal, gradient


def chain_meats(
    seen: Observations,
    cuts: NDArray[np.int64],
    states: Array,
    weights: Array,
    share: Array,
    scatter: ErrorModel,
    size: int,
) -> Array:
    """Covariances (flights, size, size) of the gradients of `chain_sums` when the errors are as `scatter` says: the middle of
    a sandwich."""
    meats = np.zeros((len(states), size, size))
    strength = share**2 * scatter.scale**2
    for rows, state, meat in zip(itertools.pairwise(cuts), states, meats, strict=True):
        part = seen.rows(slice(*rows))
        kernels.meat(
            *_arrays(part)[::3], part.lean, weights[slice(*rows)], strength, state, scatter.wander, scatter.memory_s, meat
        )  # fmt: skip
    return meats


def roll_out(
    first: Array, times_s: Array, jumps: Array, is_open: NDArray[np.bool_], free: Array
) -> tuple[Array, Array, Array]:
    """Packed start states (N + 1, 14) of a chain of flights, those at the end of each (N, 14), and the derivatives
    (N, 12, 12) of the ends by the starts. The chain goes on from `first` (14,) over `jumps` (N, 6) of velocity and spin at
    `times_s` (N,), or with the state `free` (N, 14) where a link is open."""
    n = len(times_s)
    states, ends, passages = np.empty((n + 1, 14)), np.empty((n, 14)), np.zeros((n, 12, 12))
    kernels.roll(first, times_s, jumps, is_open, free, states, ends, passages)
    return states, ends, passages


def fit_flight(seen: Observations) -> tuple[State, Array, float]:
    """One flight through some frames, each erring for itself: its state at the middle frame, the covariance (12, 12) of
    that state, and the sum of squared sigmas left. At least two frames.

    Gauss-Newton on the exact motion, from the mean spin between neighbours and a line through the positions (fall taken
    out), until a step gains less than a thousandth.
    """
    states, inverses, left = _fitted(seen, np.array([0, len(seen)]))
    return unpacked(states[0]), inverses[0], float(left[0])


def fit_flights(seen: Observations, groups: Sequence[NDArray[np.int64]]) -> tuple[Array, Array]:
    """As `fit_flight` for many groups of rows at once: packed states (groups, 14), and the sums of squared sigmas (groups,)
    left."""
    states, left = np.empty((len(groups), 14)), np.empty(len(groups))
    for k in range(0, len(groups), AT_ONCE):
        some = groups[k : k + AT_ONCE]
        ends = np.concatenate([[0], np.cumsum([len(group) for group in some])]).astype(np.int64)
        states[k : k + AT_ONCE], _, left[k : k + AT_ONCE] = _fitted(seen.rows(np.concatenate(some)), ends)
    return states, left


def _fitted(seen: Observations, ends: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """States (g, 14), covariances (g, 12, 12) and squares (g,) of groups of frames that lie one after the other."""
    states, inverses, left = np.empty((len(ends) - 1, 14)), np.empty((len(ends) - 1, 12, 12)), np.empty(len(ends) - 1)
    kernels.fit_many(*_arrays(seen), ends, states, inverses, left)
    return states, inverses, left


def seen_minus_motion(seen: Observations, state: State) -> Array:
    """Whitened residuals (n, 6) of frames from one motion."""
    return chain_misses(
        replace(seen, lean=seen.lean[:, :, :0]), np.array([0, len(seen)]), packed(state)[None], np.zeros(0)
    )


def misfits(seen: Observations, state: State) -> Array:
    """Distance (n,) of frames from a motion, in sigmas (root mean square of six)."""
    return np.asarray(np.sqrt((seen_minus_motion(seen, state) ** 2).mean(1)))


def left_jacobians(v: Array) -> Array:
    """J(v) (n, 3, 3) with exp(v + δ) = exp(J δ) exp(v), for v (n, 3). Below 1e-3 rad the series is used: it is
    exact to rounding there, while (v - sin v)/v³ has lost seven digits."""
    angle = np.linalg.norm(v, axis=1)[:, None, None]
    V = np.zeros((len(v), 3, 3))
    V[:, 0, 1], V[:, 0, 2], V[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    V -= V.transpose(0, 2, 1)
    small = angle < 1e-3
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    return np.asarray(np.eye(3) + first * V + second * (V @ V))


def pose_jacobian(flight: Flight, times_s: Array) -> Array:
    """Derivatives (n, 6, 12) of the pose at instants (n,) with respect to the flight's start state."""
    tau = np.asarray(times_s, float) - flight.start.time_s
    turns = np.outer(tau, flight.start.omega_rad_s)
    M = np.zeros((len(tau), 6, 12))
    M[:, 0:3, 0:3] = np.eye(3)
    M[:, 0:3, 6:9] = tau[:, None, None] * np.eye(3)
    M[:, 3:6, 3:6] = matrix_from_quat(quat_from_rotvec(turns))
    M[:, 3:6, 9:12] = tau[:, None, None] * left_jacobians(turns)
    return M


def transition_matrices(flight: Flight, times_s: Array) -> Array:
    """Derivatives (n, 12, 12) of the state at instants (n,) with respect to the flight's start state."""
    M = np.tile(np.eye(12), (len(times_s), 1, 1))
    M[:, :6] = pose_jacobian(flight, times_s)
    return M


def transition_matrix(flight: Flight, time_s: float) -> Array:
    """Derivative (12, 12) of the state at one instant with respect to the flight's start state."""
    return np.asarray(transition_matrices(flight, np.array([time_s]))[0])


def perturbed(state: State, change: Array) -> State:
    """The state after a change of position, rotation vector, velocity and angular velocity (12,)."""
    return State(
        state.time_s,
        state.position_m + change[0:3],
        quat_multiply(quat_from_rotvec(change[3:6]), state.quaternion),
        state.velocity_m_s + change[6:9],
        state.omega_rad_s + change[9:12],
    )


OPEN_PIVOT = 1e-8
"""Squared pivot of a scaled matrix below which the data may leave something open: rounding moves one by some 1e-14."""


def scaled_inverse(matrix: Array) -> Array:
    """Inverse of a symmetric matrix whose parameters differ by ten orders of magnitude (seconds, metres, rad/s): the
    diagonal is scaled to one first, and what the data leave open gets the pseudo-inverse.

    The pseudo-inverse wants eigenvalues, which take a hundred times as long as Cholesky's factor: it is kept for where
    that finds a pivot too small.
    """
    known = np.diag(matrix) > 0.0
    unit = np.where(known, 1.0 / np.sqrt(np.where(known, np.diag(matrix), 1.0)), 0.0)
    scaled = matrix * np.outer(unit, unit)
    if _is_settled(scaled):
        inverse = np.linalg.inv(scaled)
        inverse = 0.5 * (inverse + inverse.T)
    else:
        inverse = np.linalg.pinv(scaled, rcond=1e-14, hermitian=True)
    return np.asarray(inverse * np.outer(unit, unit))


def _is_settled(scaled: Array) -> bool:
    try:
        pivots = np.diag(np.linalg.cholesky(scaled))
    except np.linalg.LinAlgError:
        return False
    return bool(pivots.min() ** 2 > OPEN_PIVOT)


def _whiteners(C: Array) -> Array:
    """C^-½ (n, 6, 6), symmetric with metres and radians scaled to each other: it turns with the covariance, where a
    triangular factor would mix axes in an order that means nothing."""
    unit = np.sqrt(np.einsum("nii->i", C) / max(len(C), 1))
    unit = np.repeat([np.sqrt((unit[:3] ** 2).mean()), np.sqrt((unit[3:] ** 2).mean())], 3)
    values, vectors = np.linalg.eigh(C / np.outer(unit, unit))
    root = (vectors / np.sqrt(np.maximum(values, 1e-14))[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.ascontiguousarray(root / unit)


def _arrays(seen: Observations) -> tuple[Array, Array, Array, Array]:
    return (
        np.ascontiguousarray(seen.time_s, np.float64),
        np.ascontiguousarray(seen.position_m),
        np.ascontiguousarray(seen.quaternion),
        np.ascontiguousarray(seen.whitener),
    )


def packed(state: State) -> Array:
    """(14,): time, position, quaternion, velocity, angular velocity."""
    return np.concatenate([[state.time_s], state.position_m, state.quaternion, state.velocity_m_s, state.omega_rad_s])


def unpacked(numbers: Array) -> State:
    """The state of `packed` numbers."""
    return State(float(numbers[0]), numbers[1:4], numbers[4:8], numbers[8:11], numbers[11:14])
