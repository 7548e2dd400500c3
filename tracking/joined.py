"""Flights joined by impacts, fitted to the poses of many frames at once.

In flight the motion is exact (a parabola and a constant angular velocity), so a throw with N bounces has twelve numbers
for its first flight, and for each bounce its instant t, the jump Δv of the velocity and the jump Δω of the spin. Position
and orientation are continuous at t: before and after meet there, which is what gives the bounce its sub-frame time. Where
several contacts follow each other too fast to be told apart no single instant joins the flights; such a link is *open*
and the flight after it has twelve free numbers of its own.

First-order changes, with E = exp(ω τ) and left (world) rotation increments, R_true = exp(δθ) R:

    δp(t) = δp + τ δv          δθ(t) = E δθ + τ J(ω τ) δω          J: left Jacobian of SO(3)
    at an impact:  δp' = δp(t) - Δv δt     δv' = δv + δ(Δv)     δθ' = δθ(t) - Δω δt     δω' = δω + δ(Δω)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model.motion import GRAVITY_M_S2, Flight, State
from ..model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between

Array = NDArray[np.float64]

SLACK_POSITION_M, SLACK_ROTATION_RAD = 1.5e-5, 1.0e-3
"""Added to each frame's own sigma: what shading and marks do to a single pose beyond its noise."""
CUT_SIGMA = 4.685
"""Frames beyond this many sigmas (of the six numbers together, scaled) carry no weight: Tukey's biweight."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """Poses of single frames, as the fit wants them."""

    time_s: Array
    position_m: Array
    quaternion: Array
    whitener: Array
    """(n, 6, 6): W with WᵀW the inverse covariance."""

    @staticmethod
    def from_poses(time_s: Array, position_m: Array, quaternion: Array, covariance: Array) -> Sightings:
        """Poses of frames (n,) with their covariance (n, 6, 6), slack added; where that is NaN, slack alone."""
        slack = np.diag([SLACK_POSITION_M**2] * 3 + [SLACK_ROTATION_RAD**2] * 3)
        known = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
        C = np.where(known[:, None, None], covariance, 0.0) + slack
        return Sightings(time_s, position_m, quaternion, np.linalg.inv(np.linalg.cholesky(C)))

    def rows(self, which: NDArray[np.int64]) -> Sightings:
        """Some of the frames."""
        return Sightings(self.time_s[which], self.position_m[which], self.quaternion[which], self.whitener[which])


@dataclass(frozen=True, eq=False)
class Joined:
    """A fitted chain of flights."""

    flights: tuple[Flight, ...]
    """With covariance."""
    links_s: Array
    """(N,) instants that separate them."""
    open: NDArray[np.bool_]
    """(N,) where no single instant joins the flights."""
    covariance: Array
    """Of all parameters, scaled to the residuals."""
    maps: tuple[Array, ...]
    """Each flight's (12, parameters) derivative of its start state."""
    sigma_time_s: Array
    """(N,) standard error of each instant; NaN for open links."""
    time_columns: NDArray[np.int64]
    """(N,) which parameter each instant is; -1 for open links."""
    residual: Array
    """(n,) distance of each frame from the motion, in sigmas of its six numbers (root mean square)."""
    scale: float
    """By how much the frames' own covariances are too small, as a factor on sigma; at least 1."""


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


def transitions(flight: Flight, times_s: Array) -> Array:
    """Derivatives (n, 12, 12) of the state at instants (n,) with respect to the flight's start state."""
    tau = np.asarray(times_s, float) - flight.start.time_s
    turns = np.outer(tau, flight.start.omega_rad_s)
    M = np.tile(np.eye(12), (len(tau), 1, 1))
    M[:, 0:3, 6:9] = tau[:, None, None] * np.eye(3)
    M[:, 3:6, 3:6] = matrix_from_quat(quat_from_rotvec(turns))
    M[:, 3:6, 9:12] = tau[:, None, None] * left_jacobians(turns)
    return M


def transition(flight: Flight, time_s: float) -> Array:
    """Derivative (12, 12) of the state at one instant with respect to the flight's start state."""
    return np.asarray(transitions(flight, np.array([time_s]))[0])


def moved(state: State, change: Array) -> State:
    """The state after a change of position, rotation vector, velocity and angular velocity (12,)."""
    return State(
        state.time_s,
        state.position_m + change[0:3],
        quat_multiply(quat_from_rotvec(change[3:6]), state.quaternion),
        state.velocity_m_s + change[6:9],
        state.omega_rad_s + change[9:12],
    )


def fit_flight(seen: Sightings) -> tuple[State, Array, float]:
    """One flight through some frames: its state at the middle frame, the covariance (12, 12) of that state, and the sum
    of squared sigmas left. At least two frames.

    The start is a weighted line through positions (fall taken out) and rotation vectors. That line is exact without
    noise only: near a whole turn from the middle frame the rotation vector amplifies noise without bound, so
    Gauss-Newton steps on the exact motion follow, until one gains less than a thousandth.
    """
    middle = len(seen.time_s) // 2
    t = seen.time_s - seen.time_s[middle]
    fall = seen.position_m + np.outer(0.5 * GRAVITY_M_S2 * t * t, [0.0, 0.0, 1.0])
    turns = _unwrapped(rotation_between(seen.quaternion[middle], seen.quaternion), t)
    W = seen.whitener
    design = np.concatenate([W, W * t[:, None, None]], axis=2)
    inverse = _inverse(design)
    target = np.einsum("nij,nj->ni", W, np.concatenate([fall, turns], axis=1))
    x = inverse @ np.einsum("nia,ni->a", design, target)
    base = State(float(seen.time_s[middle]), np.zeros(3), seen.quaternion[middle], x[6:9], x[9:12])
    state = moved(base, np.concatenate([x[0:6], np.zeros(6)]))
    residual = seen_minus_motion(seen, state)
    left = float((residual**2).sum())
    for _ in range(8):
        design = W @ transitions(Flight(state, np.inf), seen.time_s)[:, :6]
        inverse = _inverse(design)
        trial = moved(state, inverse @ np.einsum("nia,ni->a", design, residual))
        new = seen_minus_motion(seen, trial)
        new_left = float((new**2).sum())
        if not new_left < left:
            break
        gain, state, residual, left = left - new_left, trial, new, new_left
        if gain < 1e-3 * left:
            break
    return state, inverse, left


def seen_minus_motion(seen: Sightings, state: State) -> Array:
    """Whitened residuals (n, 6) of frames from one motion."""
    p, q = Flight(state, np.inf).poses(seen.time_s)
    raw = np.concatenate([seen.position_m - p, rotation_between(q, seen.quaternion)], axis=1)
    return np.asarray(np.einsum("nij,nj->ni", seen.whitener, raw))


def _inverse(design: Array) -> Array:
    """Inverse of the normal matrix of a design (n, 6, 12). Small normal equations rather than a tall QR: threaded
    libraries spend more on waking up than on the work. Columns differ by the frame spacing; with the diagonal scaled
    to one the matrix of a flight is well conditioned."""
    A = np.einsum("nia,nib->ab", design, design)
    unit = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    inverse = np.linalg.pinv(A * np.outer(unit, unit), rcond=1e-12, hermitian=True)
    return np.asarray(inverse * np.outer(unit, unit))


def _unwrapped(turns: Array, t: Array) -> Array:
    """Rotation vectors followed past half a turn: each is taken on the branch nearest to its neighbour's course."""
    out = turns.copy()
    zero = int(np.argmin(np.abs(t)))
    for direction in (1, -1):
        k = zero + direction
        while 0 <= k < len(t):
            last = out[k - direction]
            guess = last * (t[k] / t[k - direction]) if t[k - direction] != 0 else out[k]
            angle = float(np.linalg.norm(turns[k]))
            if angle > 1e-9:
                axis = turns[k] / angle
                rounds = np.round((guess @ axis - angle) / (2.0 * np.pi))
                out[k] = axis * (angle + 2.0 * np.pi * rounds)
            k += direction
    return out


def fit_joined(
    seen: Sightings, starts: Sequence[State], links_s: Sequence[float], open_links: Sequence[bool], steps: int = 40
) -> Joined:
    """Least squares over a whole chain: Gauss-Newton with Levenberg's damping and biweight frames.

    `starts` (N + 1) are guesses of each flight's state (only the velocities matter for flights behind a joined link),
    `links_s` (N) the guessed instants. Deterministic; a chain that cannot be improved is returned as it is.
    """
    chain = _Chain.from_guess(seen, list(starts), np.array(links_s, float), np.array(open_links, bool))
    scale, weights = 1.0, np.ones(len(seen.time_s))
    damping = 1e-6
    residual, jacobian = chain.residual_and_jacobian()
    for turn in range(steps):
        rms = np.sqrt((residual**2).mean(1))
        # The median of the rms of six unit normals is 0.944.
        scale = max(float(np.median(rms)) / 0.944, 1e-12)
        q = rms / (scale * CUT_SIGMA * (3.0 if turn < 3 else 1.0))
        weights = np.where(q < 1.0, (1.0 - q * q) ** 2, 0.0)
        A = np.einsum("n,nia,nib->ab", weights, jacobian, jacobian)
        g = np.einsum("n,nia,ni->a", weights, jacobian, residual)
        cost = float(weights @ (residual**2).sum(1))
        done = False
        for _ in range(12):
            step = np.linalg.solve(A + damping * np.diag(np.diag(A) + 1e-12 * np.trace(A)), -g)
            trial = chain.stepped(step)
            new_residual, new_jacobian = trial.residual_and_jacobian()
            new_cost = float(weights @ (new_residual**2).sum(1))
            if np.isfinite(new_cost) and new_cost <= cost * (1.0 + 1e-12):
                done = cost - new_cost < 1e-9 * cost and turn >= 5
                chain, residual, jacobian = trial, new_residual, new_jacobian
                damping = max(damping * 0.1, 1e-12)
                break
            damping = max(damping * 10.0, 1e-9)
        else:
            break
        if done:
            break
    rms = np.sqrt((residual**2).mean(1))
    scale = max(1.0, float(np.median(rms)) / 0.944)
    A = np.einsum("n,nia,nib->ab", weights, jacobian, jacobian)
    # Parameters differ by ten orders of magnitude (seconds, metres, rad/s): invert the correlation, not the matrix.
    unit = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    covariance = np.linalg.pinv(A * np.outer(unit, unit), rcond=1e-13, hermitian=True) * np.outer(unit, unit) * scale**2
    return chain.finished(covariance, rms, scale)


@dataclass(frozen=True, eq=False)
class _Chain:
    """The unknowns: the first state, and for each link either (t, Δv, Δω) or a free state."""

    seen: Sightings
    first: State
    links_s: Array
    open: NDArray[np.bool_]
    jumps: Array
    """(N, 6) Δv, Δω at joined links."""
    free: tuple[State | None, ...]

    @staticmethod
    def from_guess(seen: Sightings, starts: list[State], links: Array, open_links: NDArray[np.bool_]) -> _Chain:
        jumps = np.zeros((len(links), 6))
        free: list[State | None] = []
        for k, t in enumerate(links):
            before, after = Flight(starts[k], t).at(t), Flight(starts[k + 1], t).at(t)
            jumps[k] = np.concatenate(
                [after.velocity_m_s - before.velocity_m_s, after.omega_rad_s - before.omega_rad_s]
            )
            free.append(starts[k + 1] if open_links[k] else None)
        return _Chain(seen, starts[0], links, open_links, jumps, tuple(free))

    def states_and_maps(self) -> tuple[list[State], list[Array]]:
        """Start state of each flight and its derivative with respect to all parameters."""
        total = 12 + sum(12 if o else 7 for o in self.open)
        S = np.zeros((12, total))
        S[:, :12] = np.eye(12)
        states, maps = [self.first], [S]
        column = 12
        for k, t in enumerate(self.links_s):
            free = self.free[k]
            if free is not None:
                S = np.zeros((12, total))
                S[:, column : column + 12] = np.eye(12)
                states.append(free)
                maps.append(S)
                column += 12
                continue
            flight = Flight(states[-1], t)
            end = flight.at(t)
            S = transition(flight, t) @ maps[-1]
            S[0:3, column] -= self.jumps[k, :3]
            S[3:6, column] -= self.jumps[k, 3:]
            S[6:9, column + 1 : column + 4] = np.eye(3)
            S[9:12, column + 4 : column + 7] = np.eye(3)
            # The velocity at the link changes with its instant only through gravity, which both sides share.
            states.append(
                State(t, end.position_m, end.quaternion, end.velocity_m_s + self.jumps[k, :3],
                      end.omega_rad_s + self.jumps[k, 3:])
            )  # fmt: skip
            maps.append(S)
            column += 7
        return states, maps

    def residual_and_jacobian(self) -> tuple[Array, Array]:
        """Whitened residuals (n, 6), seen minus motion, and their derivative (n, 6, parameters)."""
        states, maps = self.states_and_maps()
        which = np.searchsorted(self.links_s, self.seen.time_s, side="right")
        residual = np.empty((len(which), 6))
        jacobian = np.empty((len(which), 6, maps[0].shape[1]))
        for k, state in enumerate(states):
            mine = np.flatnonzero(which == k)
            if not len(mine):
                continue
            part = self.seen.rows(mine)
            residual[mine] = seen_minus_motion(part, state)
            jacobian[mine] = -part.whitener @ (transitions(Flight(state, np.inf), part.time_s)[:, :6] @ maps[k])
        return residual, jacobian

    def stepped(self, step: Array) -> _Chain:
        """The chain after a step of all parameters; links keep their order and move by half a frame at the most."""
        links, jumps, free = self.links_s.copy(), self.jumps.copy(), list(self.free)
        spacing = float(np.median(np.diff(self.seen.time_s))) if len(self.seen.time_s) > 1 else np.inf
        column = 12
        for k, is_open in enumerate(self.open):
            state = self.free[k]
            if is_open and state is not None:
                free[k] = moved(state, step[column : column + 12])
                column += 12
                continue
            links[k] += np.clip(step[column], -0.5 * spacing, 0.5 * spacing)
            jumps[k] += step[column + 1 : column + 7]
            column += 7
        for k in range(1, len(links)):
            links[k] = max(links[k], links[k - 1] + 1e-6 * spacing)
        return _Chain(self.seen, moved(self.first, step[:12]), links, self.open, jumps, tuple(free))

    def finished(self, covariance: Array, residual: Array, scale: float) -> Joined:
        states, maps = self.states_and_maps()
        sigma, columns, column = [], [], 12
        for is_open in self.open:
            columns.append(-1 if is_open else column)
            sigma.append(np.nan if is_open else float(np.sqrt(max(covariance[column, column], 0.0))))
            column += 12 if is_open else 7
        ends = [*self.links_s, float(self.seen.time_s[-1])]
        flights = []
        for k, (state, S) in enumerate(zip(states, maps, strict=True)):
            flight = Flight(state, float(ends[k]))
            C = S @ covariance @ S.T
            if k == 0 or self.open[k - 1]:
                # A free state is kept at its reference instant; the flight is quoted from where it begins.
                begin = float(self.seen.time_s[0]) if k == 0 else float(self.links_s[k - 1])
                M = transition(flight, begin)
                C, state, S = M @ C @ M.T, flight.at(begin), M @ S
            maps[k] = S
            flights.append(Flight(state, float(ends[k]), (C + C.T) / 2.0))
        return Joined(
            tuple(flights),
            self.links_s,
            self.open,
            covariance,
            tuple(maps),
            np.array(sigma),
            np.array(columns, np.int64),
            residual,
            scale,
        )
