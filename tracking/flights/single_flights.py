"""One flight through the poses of its frames: exact motion, and errors that are correlated from frame to frame.

In flight the motion is a parabola and, of a spherical top, a constant angular velocity ω. With E = exp(ω τ) and left (world)
increments of a rotation, R_true = exp(δθ) R, a change of state changes the pose a time τ later by

    δp(τ) = δp + τ δv          δθ(τ) = E δθ + τ J(ω τ) δω          J: left Jacobian of SO(3).

A body with several moments of inertia turns by Euler's equations, and both matrices are integrated with them (`turning`).

**Errors.** A frame's six errors, whitened by the covariance that the frame states (z = C^-½ e), are modelled as

    z_k = w_k + c_k + C_k^-½ L_k s,     Var w = σ²,   Var c = σ² a,   corr(c_j, c_k) = exp(-|t_j - t_k|/T),

with σ, a and T for each of the six (`ErrorModel`). w is the noise of the frame's own pixels. c is the effect of shading, grain
and marks that move slowly over the edges: a first-order autoregression. L s is an error common to all frames of the clip
(`shared_bias`): L is the bias Jacobian of the frame, s a few numbers that all flights share."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.engine.asymmetric import TorqueFree
from ...model.rotations import cross_matrix, matrix_from_quat, quat_from_rotvec, quat_multiply
from ...model.throw import EVEN, Flight, State, Turning, turns_in_flight
from ...model.world import GRAVITY_M_S2
from ..covariance import SINGULAR_EIGENVALUE
from . import flight_kernels as kernels
from .flight_kernels import FrameInformation, PoseArrays
from .turning import fill_spin_rates

Array = NDArray[np.float64]

SMALL_ANGLE_RAD = 1e-4
"""Rotation below which the left Jacobian takes its limit. (θ - sin θ)/θ³ still has eight digits there and is multiplied by θ²;
the limit is exact to 1e-9."""

UNMODELLED_POSITION_M = 1.5e-5
"""Standard deviation [m] added to each frame's own if nothing has measured the effect of shading and marks on a pose."""
UNMODELLED_ROTATION_RAD = 1.0e-3
"""The same for the orientation [rad]."""
GROUPS_PER_BATCH = 64
"""Groups whose frames are gathered at once: all groups of a long clip would take more memory than the clip's poses."""


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """Size of the frames' whitened errors relative to the stated sigmas, and their correlation: six numbers of each."""

    scale: Array
    """(6,) σ: factor on the frame's own sigma, for the white part."""
    variance_ratio: Array
    """(6,) a: variance of the autocorrelated part over that of the white part."""
    correlation_time_s: Array
    """(6,) T: time [s] after which the correlation has fallen to 1/e."""

    @staticmethod
    def white(scale: float = 1.0) -> ErrorModel:
        """Independent errors, so many times as large as stated."""
        return ErrorModel(np.full(6, scale), np.zeros(6), np.ones(6))

    @property
    def variance(self) -> Array:
        """(6,) of a single whitened error: σ² (1 + a)."""
        return self.scale**2 * (1.0 + self.variance_ratio)

    def long_run_variance(self, spacing_s: float) -> Array:
        """(6,) of a whitened error as it counts in a mean over many frames `spacing_s` apart.

        It is the spectral density at frequency zero, σ² (1 + a (1 + φ)/(1 - φ)) with φ = exp(-spacing/T)."""
        keep = np.exp(-spacing_s / self.correlation_time_s)
        return np.asarray(self.scale**2 * (1.0 + self.variance_ratio * (1.0 + keep) / (1.0 - keep)))


@dataclass(frozen=True, eq=False)
class WeightedPoses:
    """Poses of single frames with their weights, as the fits need them."""

    time_s: Array
    """(n,) mid-exposure."""
    position_m: Array
    """(n, 3)."""
    quaternion: Array
    """(n, 4) wxyz."""
    whitener: Array
    """(n, 6, 6): W with WᵀW the inverse covariance."""
    bias_jacobian: Array
    """(n, 6, m) change of the pose for each of m errors that the whole clip shares; m may be 0."""
    gravity_m_s2: float = GRAVITY_M_S2
    """With which the die falls, along -z."""
    turning: Turning = EVEN
    """How it turns."""

    @staticmethod
    def from_poses(
        time_s: Array, position_m: Array, quaternion: Array, covariance: Array, *, unmodelled: float = 1.0,
        gravity_m_s2: float = GRAVITY_M_S2, turning: Turning = EVEN,
    ) -> WeightedPoses:  # fmt: skip
        """Poses of frames (n,) with their covariance (n, 6, 6).

        `unmodelled` is the factor on UNMODELLED_POSITION_M and UNMODELLED_ROTATION_RAD, whose squares are added. A frame whose
        covariance is NaN has those alone, with factor 1."""
        most = np.diag([UNMODELLED_POSITION_M**2] * 3 + [UNMODELLED_ROTATION_RAD**2] * 3)
        known = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
        C = np.where(known[:, None, None], np.where(known[:, None, None], covariance, 0.0) + unmodelled**2 * most, most)
        none_shared = np.zeros((len(time_s), 6, 0))
        return WeightedPoses(time_s, position_m, quaternion, _whiteners(C), none_shared, gravity_m_s2, turning)

    def with_bias_jacobian(self, bias_jacobian: Array) -> WeightedPoses:
        """The same frames with errors (n, 6, m) that the clip shares."""
        return replace(self, bias_jacobian=np.ascontiguousarray(bias_jacobian))

    def rows(self, which: NDArray[np.int64] | slice) -> WeightedPoses:
        """Some of the frames."""
        return WeightedPoses(
            self.time_s[which],
            self.position_m[which],
            self.quaternion[which],
            self.whitener[which],
            self.bias_jacobian[which],
            self.gravity_m_s2,
            self.turning,
        )

    def flight(self, state: State) -> Flight:
        """The flight of a die that falls as here, from a state on."""
        return Flight(state, np.inf, gravity_m_s2=self.gravity_m_s2, turning=self.turning)

    def __len__(self) -> int:
        return len(self.time_s)


# --- a chain of flights ------------------------------------------------------------------------------------------------


def chain_residuals(observations: WeightedPoses, cuts: NDArray[np.int64], states: Array, shared: Array) -> Array:
    """Whitened residuals (n, 6) of frames from the motions of flights, with the shared errors (m,) subtracted.

    Rows cuts[k] to cuts[k + 1] belong to the packed state (14,) `states[k]`."""
    residuals = np.empty((len(observations), 6))
    kernels.residuals(pose_arrays(observations), shared, cuts, states, residuals)
    return residuals


def frame_information(observations: WeightedPoses, share: Array) -> FrameInformation:
    """Information of each frame on its pose and the shared errors. The six whitened numbers count with their `share` (6,)."""
    n, own = len(observations), 6 + observations.bias_jacobian.shape[2]
    information = FrameInformation(np.empty((n, own, own)), np.empty((n, own, 6)))
    kernels.frame_information(pose_arrays(observations), share, information)
    return information


def normal_equations(
    observations: WeightedPoses,
    cuts: NDArray[np.int64],
    states: Array,
    residuals: Array,
    weights: Array,
    information: FrameInformation,
    size: int,
) -> tuple[Array, Array]:
    """Normal equations of each flight about its state: matrices (flights, size, size) and gradients (flights, size) of half the
    cost.

    The unknowns are the twelve numbers of the state, then the m shared errors; entries beyond 12 + m stay zero. Frames count with
    their weight (n,); `information` is that of `frame_information`."""
    normal, gradient = np.zeros((len(states), size, size)), np.zeros((len(states), size))
    kernels.normal_equations(pose_arrays(observations), information, residuals, weights, cuts, states, normal, gradient)
    return normal, gradient


def gradient_covariances(
    observations: WeightedPoses,
    cuts: NDArray[np.int64],
    states: Array,
    weights: Array,
    share: Array,
    errors: ErrorModel,
    size: int,
) -> Array:
    """Covariances (flights, size, size) of the gradients of `normal_equations` for errors as modelled: the middle ("meat") of a
    sandwich estimator."""
    covariances = np.zeros((len(states), size, size))
    strength = share**2 * errors.scale**2
    for rows, state, covariance in zip(itertools.pairwise(cuts), states, covariances, strict=True):
        part = observations.rows(slice(*rows))
        kernels.gradient_covariance(
            pose_arrays(part), weights[slice(*rows)], strength, state, errors.variance_ratio, errors.correlation_time_s,
            covariance,
        )  # fmt: skip
    return covariances


# --- single flights ----------------------------------------------------------------------------------------------------


def fit_flight(observations: WeightedPoses) -> tuple[State, Array, float]:
    """One flight through at least two frames with independent errors: its state at the middle frame, the covariance (12, 12) of
    that state, and the sum of squared sigmas.

    Gauss-Newton on the exact motion, from the mean spin (or angular momentum) between neighbours and a line through the
    positions (fall subtracted), until a step gains less than a thousandth."""
    states, inverses, chi2 = _fitted(observations, np.array([0, len(observations)]))
    return unpacked(states[0]), inverses[0], float(chi2[0])


def fit_flights(observations: WeightedPoses, groups: Sequence[NDArray[np.int64]]) -> tuple[Array, Array]:
    """As `fit_flight` for many groups of rows: packed states (groups, 14) and sums of squared sigmas (groups,)."""
    states, _, chi2 = fit_states(observations, groups)
    return states, chi2


def fit_states(observations: WeightedPoses, groups: Sequence[NDArray[np.int64]]) -> tuple[Array, Array, Array]:
    """As `fit_flights`, with the covariances (groups, 12, 12) of the states between the two."""
    count = len(groups)
    states, covariances, chi2 = np.empty((count, 14)), np.empty((count, 12, 12)), np.empty(count)
    for k in range(0, count, GROUPS_PER_BATCH):
        batch = slice(k, k + GROUPS_PER_BATCH)
        some = groups[batch]
        ends = np.concatenate([[0], np.cumsum([len(group) for group in some])]).astype(np.int64)
        states[batch], covariances[batch], chi2[batch] = _fitted(observations.rows(np.concatenate(some)), ends)
    return states, covariances, chi2


def _fitted(observations: WeightedPoses, ends: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """States (g, 14), covariances (g, 12, 12) and sums of squares (g,) of groups of frames that lie one after the other."""
    states, inverses, chi2 = np.empty((len(ends) - 1, 14)), np.empty((len(ends) - 1, 12, 12)), np.empty(len(ends) - 1)
    kernels.fit_flights(pose_arrays(observations), ends, states, inverses, chi2)
    return states, inverses, chi2


def flight_residuals(observations: WeightedPoses, state: State) -> Array:
    """Whitened residuals (n, 6) of frames from one motion."""
    return chain_residuals(
        replace(observations, bias_jacobian=observations.bias_jacobian[:, :, :0]),
        np.array([0, len(observations)]),
        packed(state)[None],
        np.zeros(0),
    )


def rms_residuals(observations: WeightedPoses, state: State) -> Array:
    """Distance (n,) of frames from a motion, in sigmas (root mean square of six)."""
    return np.asarray(np.sqrt((flight_residuals(observations, state) ** 2).mean(1)))


# --- derivatives -------------------------------------------------------------------------------------------------------


def left_jacobians(v: Array) -> Array:
    """J(v) (n, 3, 3) with exp(v + δ) = exp(J δ) exp(v), for v (n, 3) [rad]; below `SMALL_ANGLE_RAD` its limit.

    The half angle keeps the digits of (1 - cos θ)/θ², of which the difference loses ten at 1e-3 rad.
    """
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    closed = angle > SMALL_ANGLE_RAD
    safe = np.where(closed, angle, 1.0)
    cross = cross_matrix(v)
    first = np.where(closed, 2.0 * np.sin(safe / 2.0) ** 2 / safe**2, 0.5)
    second = np.where(closed, (safe - np.sin(safe)) / safe**3, 1.0 / 6.0)
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def pose_jacobian(flight: Flight, times_s: Array) -> Array:
    """Derivatives (n, 6, 12) of the pose at instants (n,) with respect to the flight's start state."""
    tau = np.asarray(times_s, float) - flight.start.time_s
    M = np.zeros((len(tau), 6, 12))
    M[:, 0:3, 0:3] = np.eye(3)
    M[:, 0:3, 6:9] = tau[:, None, None] * np.eye(3)
    if isinstance(flight.turning, TorqueFree):
        turned = turns_in_flight(flight.turning, flight.start, tau).transitions
        M[:, 3:6, 3:6], M[:, 3:6, 9:12] = turned[:, :3, :3], turned[:, :3, 3:]
        return M
    turns = np.outer(tau, flight.start.omega_rad_s)
    M[:, 3:6, 3:6] = matrix_from_quat(quat_from_rotvec(turns))
    M[:, 3:6, 9:12] = tau[:, None, None] * left_jacobians(turns)
    return M


def transition_matrices(flight: Flight, times_s: Array) -> Array:
    """Derivatives (n, 12, 12) of the state at instants (n,) with respect to the flight's start state."""
    M = np.tile(np.eye(12), (len(times_s), 1, 1))
    M[:, :6] = pose_jacobian(flight, times_s)
    if isinstance(flight.turning, TorqueFree):
        delays = np.asarray(times_s, float) - flight.start.time_s
        turned = turns_in_flight(flight.turning, flight.start, delays).transitions
        M[:, 9:12, 3:6], M[:, 9:12, 9:12] = turned[:, 3:, :3], turned[:, 3:, 3:]
    return M


def transition_matrix(flight: Flight, time_s: float) -> Array:
    """Derivative (12, 12) of the state at one instant with respect to the flight's start state."""
    return np.asarray(transition_matrices(flight, np.array([time_s]))[0])


def spin_rates(turning: Turning, states: Array) -> Array:
    """ω̇ (n, 3) [rad/s²] of a body in flight with packed states (n, 14)."""
    rates = np.empty((len(states), 3))
    fill_spin_rates(turning, np.ascontiguousarray(states), rates)
    return rates


def spin_jumps(observations: WeightedPoses, starts: Sequence[State], times_s: Array) -> Array:
    """(N, 3) [rad/s] by which the spin of each motion, given by its start, differs from that of the one before, at the instants
    (N,) between them."""
    if not isinstance(observations.turning, TorqueFree):
        return np.diff([start.omega_rad_s for start in starts], axis=0).reshape(-1, 3)
    motions = itertools.pairwise([observations.flight(start) for start in starts])
    jumps = [b.at(t).omega_rad_s - a.at(t).omega_rad_s for (a, b), t in zip(motions, times_s.tolist(), strict=True)]
    return np.array(jumps).reshape(-1, 3)


def perturbed(state: State, change: Array) -> State:
    """The state after a change of position, rotation vector, velocity and angular velocity (12,)."""
    return State(
        state.time_s,
        state.position_m + change[0:3],
        quat_multiply(quat_from_rotvec(change[3:6]), state.quaternion),
        state.velocity_m_s + change[6:9],
        state.omega_rad_s + change[9:12],
    )


# --- matrices and packing ----------------------------------------------------------------------------------------------


def _whiteners(C: Array) -> Array:
    """C^-½ (n, 6, 6), symmetric after scaling metres and radians to each other. It rotates with the covariance; a triangular
    factor would mix the axes in an arbitrary order."""
    unit = np.sqrt(np.einsum("nii->i", C) / max(len(C), 1))
    unit = np.repeat([np.sqrt((unit[:3] ** 2).mean()), np.sqrt((unit[3:] ** 2).mean())], 3)
    values, vectors = np.linalg.eigh(C / np.outer(unit, unit))
    root = (vectors / np.sqrt(np.maximum(values, SINGULAR_EIGENVALUE))[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.ascontiguousarray(root / unit)


def pose_arrays(observations: WeightedPoses) -> PoseArrays:
    """The contiguous arrays that the kernels take."""
    return PoseArrays(
        np.ascontiguousarray(observations.time_s, np.float64),
        np.ascontiguousarray(observations.position_m),
        np.ascontiguousarray(observations.quaternion),
        np.ascontiguousarray(observations.whitener),
        np.ascontiguousarray(observations.bias_jacobian),
        float(observations.gravity_m_s2),
        observations.turning,
    )


def packed(state: State) -> Array:
    """(14,): time, position, quaternion, velocity, angular velocity."""
    return np.concatenate([[state.time_s], state.position_m, state.quaternion, state.velocity_m_s, state.omega_rad_s])


def unpacked(numbers: Array) -> State:
    """The state of `packed` numbers."""
    return State(float(numbers[0]), numbers[1:4], numbers[4:8], numbers[8:11], numbers[11:14])
