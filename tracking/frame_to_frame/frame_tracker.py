"""Tracking of a die from frame to frame.

In flight the compiled `motion_filter.track_frames` predicts the pose from the motion so far, refines and judges it; it stops
where picture and motion disagree. There several initial poses compete: impacts of several strengths on each low corner, the last
pose, and rotations about it. The pose that explains the picture best is taken, and tracking continues from there. Where none
does, initial poses are searched in the picture by itself, and three such pictures in a row give the motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.die import nearest_equivalent_rotation
from ...model.rotations import angle_between, matrix_from_quat, quat_from_matrix, quat_from_rotvec, rotation_between
from ...model.throw import Flight, State
from ..footage import FrameSource
from ..picture import (
    PARAMETERS,
    STATISTICS,
    PoseRows,
    View,
    Workspace,
    flight_from,
    kept_light,
    new_workspace,
    share_in_view,
    with_occluder_mask,
)
from ..pose import (
    LEAST_CONTOUR_PX,
    ClipPoses,
    Pose,
    longest_stride,
    pose_candidates,
    pose_state,
    power_of_two,
    refine_pose,
    same_picture,
    seen_distance_m,
)
from ..throw import SMALL_MOVE_REACH, SMALL_TURN_RAD
from .acceptance import (
    ACCEPTED_EXCESS_COST,
    AMBIGUOUS_COST,
    CLEAR_SUPPORT,
    FASTEST_CENTRE_FACTOR,
    FASTEST_FACTOR,
    FASTEST_FACTOR_BACKWARDS,
    FASTEST_M_S,
    KNOWN_RAD,
    MAX_EXCESS_COST,
    MIN_POSES_OF_FLIGHT,
    MIN_SUPPORT,
    MIN_SUPPORT_CUT,
    ON_PATH_CHI2,
    PREDICTED_SIGMAS,
    SEEN_REACH,
    SMALL_EXCESS_COST,
    SURFACE_EXCESS_SHARE,
    USUAL_COST_FRAMES,
)
from .impact_trials import (
    MotionOfPoses,
    beyond_impacts,
    bounds_of_flight,
    costs_on_one_window,
    different_rates,
    initial_covariance,
    is_high,
    leaves_flight,
    motion_of_poses,
    widest_sigma,
)
from .motion_filter import (
    MotionEstimate,
    motion_prior,
    predict_motion,
    predicted_delay,
    track_frames,
    update_motion,
)

Array = NDArray[np.float64]
Frames = NDArray[Any]

UNKNOWN_REACH = 0.2
"""Standard deviation of the displacement from one frame to the next, in circumradii, if nothing is known of the motion."""
UNKNOWN_RAD = 0.12
"""The same of the rotation [rad]: well-filmed dice turn by 7 to 10 degrees a frame after a hard impact."""
BOUNCED_REACH = 0.07
"""UNKNOWN_REACH after an impact whose strength is guessed."""
BOUNCED_RAD = 0.07
"""UNKNOWN_RAD after an impact whose strength is guessed."""
LEAST_IMPROVEMENT = 0.02
"""Cost by which a later hypothesis must be better: it departs further from the prediction."""
IMPACT_SURFACE_TRIALS = 14
"""Most hypotheses whose pose is refined on the whole surface of a well-rounded die."""
MOST_DIRECT = 4
"""Those of them that are not refined on its edges before."""
MIN_POSES_BEFORE_IMPACT = 2
"""Poses of a flight from which its motion says what an impact does."""
REFINED_ANEW = 4
"""Hypotheses that are refined again if none explains the picture as usual: the few steps from afar may not have been enough."""
IMPACT_APART_EDGES = 0.06
"""Distance of corners, in edges, from which two of these lie apart."""
LOST_FRAMES = 2
"""Frames without a pose after which a die high above the table may be found off its path: the motion was wrong."""
SEARCH_EVERY = 6
"""Frames without a pose between searches for an initial pose, at the most: the first comes at once, and each that fails doubles
the distance to the next."""
BACKWARDS_MISSES = 3
"""Frames without a pose after which tracking backwards ends."""
MOST_CANDIDATES = 4
"""Poses of one picture that may lie on the motion behind an impact."""
MIN_POSES_TO_SKIP = 20
"""Poses of a flight, or since a surprise, before frames are skipped: the motion averages over as many."""
MAX_PREDICTION_SIGMA_PX = 0.3
"""Largest standard error [px] of a prediction over skipped frames."""
TRIAL_TURN_RAD = np.radians(6.0)
"""Angle [rad] of the rotations about the last pose that are tried."""


class FrameTracker:
    """Tracks the die through blocks of frames, and holds its motion in between."""

    def __init__(
        self, view: View, motion: Array, rotation: Array, P: Array, clock: Array, unused: NDArray[np.bool_]
    ) -> None:
        """`motion` (9,) position, velocity, spin; `rotation` (3, 3); `P` (12, 12) their covariance. `clock` (3,) holds the time
        [s] of these, the usual cost of a pose, and the number of poses of this flight. Frames that are `unused` (n,) are
        skipped."""
        self.view, self._occluders = with_occluder_mask(view)
        self.unused = unused
        self.motion, self.rotation, self.P, self.clock = motion, rotation, P, clock
        self.misses = 0
        """Frames without a pose since the last one with a pose."""
        self.searches = False
        """Whether an initial pose is searched where the die was lost, and a turned pose may belong to its flight: neither of a
        hypothesis that others compete with."""
        self._next_search, self._search_wait = 1, 1
        self._fastest_m_s = np.inf
        """Speed of the die's centre with all the energy that it had, apart from its height, when its motion was last known."""
        self._candidates: list[Pose] = []
        """Poses that the last picture may show, where the motion did not explain it."""
        self._surprising: list[tuple[int, list[Pose]]] = []
        """The last frames in a row that the motion did not explain, with these."""
        self.next_frame = 0
        self.backwards = False
        self._longest_step, self._skip_from, self._surprises = 1, 0, 0
        self._rates_after_impact = np.zeros((0, 6))
        """(n, 6) velocity and spin after each impact that may lie before the last pose, as long as that is the only one of its
        flight: their poses agree, and the next picture tells them apart."""
        self._work: Workspace = new_workspace(view.shape, view.rig)

    @staticmethod
    def from_pose(
        view: View, pose: Pose, times_s: Array, k: int, unused: NDArray[np.bool_], rates: Array | None = None,
        velocity_m_s: Array | None = None,
    ) -> FrameTracker:  # fmt: skip
        """A tracker that knows the pose on frame k, and, as after an impact, approximate `rates` (6,): velocity [m/s] and spin
        [rad/s]; or the part of the velocity (3,) across the line of sight, and nothing of the rest."""
        near = times_s[max(k - 1, 0) : k + 2]
        frame_s = float(np.abs(np.diff(near)).mean()) if len(near) > 1 else 1.0
        reach, rad = (UNKNOWN_REACH, UNKNOWN_RAD) if rates is None else (BOUNCED_REACH, BOUNCED_RAD)
        P = initial_covariance(view, pose, frame_s, reach, rad)
        if rates is None:
            rates = np.concatenate([np.zeros(3) if velocity_m_s is None else velocity_m_s, np.zeros(3)])
        motion = np.concatenate([pose.position_m, rates])
        exposed_s = float(times_s[k] + view.exposure_delay_s(pose.position_m))
        made = FrameTracker(view, motion, pose.rotation.copy(), P, np.array([exposed_s, pose.cost, 1.0]), unused)
        made.next_frame = k + 1
        return made

    def backwards_tracker(self) -> FrameTracker:
        """A tracker of the frames before, from the present motion."""
        back = FrameTracker(
            self.view, self.motion.copy(), self.rotation.copy(), self.P.copy(), self.clock.copy(), self.unused
        )
        back.view, back._occluders = self.view, self._occluders
        for kept, known in zip(kept_light(back._work), kept_light(self._work), strict=True):
            kept[:] = known
        back.backwards, back.searches = True, self.searches
        return back

    @property
    def usual_cost(self) -> float:
        """Usual cost of a pose on this clip."""
        return float(self.clock[1])

    def track_to_end(
        self, source: FrameSource, poses: ClipPoses, report: Callable[[int], None], *, all_frames: bool
    ) -> None:
        """Track the die through the rest of a clip; `report` is called with the next frame.

        Unless `all_frames` are wanted, frames are skipped over which the die hardly moves and the motion is known: on a film far
        faster than the die. After a surprise, such as an impact, no frame is skipped for a while."""
        self._longest_step = 1 if all_frames else longest_stride(len(source))
        while self.next_frame < len(source):
            for block in source.blocks(self.next_frame):
                with block:
                    self.track(block.frames, source.times_s, block.first, poses)
                report(self.next_frame)
                if self._step(source.times_s) > 1:
                    break
            while (step := self._step(source.times_s)) > 1:
                self._track_every(source, poses, step)
                poses.frame_stride = self._longest_step
                report(self.next_frame)
        poses.frame_stride = min(poses.frame_stride, self._longest_step)

    def _step(self, times_s: Array) -> int:
        """One in how many frames is needed next: a power of two, so that multiples of a longer step are multiples of a shorter
        one. It never exceeds what the fastest flight so far allowed: a die that finally rests must not seem filmed that fast."""
        k = self.next_frame
        is_new = self.clock[2] < MIN_POSES_TO_SKIP
        if self._longest_step == 1 or self.misses > 0 or is_new or not self._skip_from <= k < len(times_s):
            return 1
        frame_s, reach_m, camera = float(times_s[k] - times_s[k - 1]), self.view.reach_m, self.view.camera
        speed, spin = (float(np.linalg.norm(rate)) for rate in (self.motion[3:6], self.motion[6:9]))
        moved = max(speed * frame_s / (SMALL_MOVE_REACH * reach_m), spin * frame_s / SMALL_TURN_RAD, 1e-9)
        self._longest_step = power_of_two(min(self._longest_step, 1.0 / moved))
        velocity_sigma, spin_sigma = widest_sigma(self.P, 6), widest_sigma(self.P, 9)
        scale_px_per_m = camera.matrix[0, 0] / float(np.linalg.norm(self.motion[:3] - camera.centre_m))
        sigma_px = scale_px_per_m * (velocity_sigma + reach_m * spin_sigma) * frame_s
        return power_of_two(min(self._longest_step, MAX_PREDICTION_SIGMA_PX / sigma_px))

    def _track_every(self, source: FrameSource, poses: ClipPoses, step: int) -> None:
        """Track one frame in `step`, a block of them, or until one surprises: from the frame before it on none is skipped."""
        rows = np.arange(-(-self.next_frame // step) * step, len(source), step)[: source.block_frames]
        rows = rows[~self.unused[rows]]
        done = 0
        if len(rows):
            frames = np.stack([source.frame(int(k)) for k in rows])
            done = self._track_in_flight(frames, rows, source.times_s, poses, ON_PATH_CHI2)
        if done:
            self.next_frame, self._surprises = int(rows[done - 1]) + 1, 0
        if done < len(rows) or not len(rows):
            # A die that rolls or rests moves as no flight does, and surprises again and again.
            last = int(rows[done]) if len(rows) else self.next_frame
            self._skip_from = last + (MIN_POSES_TO_SKIP << self._surprises)
            self._surprises += 1

    def track(self, frames: Frames, times_s: Array, first: int, poses: ClipPoses) -> None:
        """Track the die over frames (n, cameras, height, width), the first of which is frame `first` of the clip, and write the
        poses; from the last frame to the first if the tracker runs backwards."""
        order = np.flatnonzero(~self.unused[first : first + len(frames)])
        if self.backwards:
            order = order[::-1]
        else:
            order = order[first + order >= self.next_frame]
        done = 0
        while done < len(order):
            left = order[done:]
            # Contiguous in both directions: the kernel is compiled once, and consecutive frames need no copy.
            is_consecutive = left[-1] - left[0] == len(left) - 1
            some = np.ascontiguousarray(frames[left[0] : left[-1] + 1] if is_consecutive else frames[left])
            done += self._track_in_flight(some, first + left, times_s, poses)
            if done == len(order):
                break
            k = int(order[done])
            found = self._pose_by_hypotheses(np.asarray(frames[k], np.float32), float(times_s[first + k]))
            if found is not None:
                poses.put(first + k, found, self.motion[3:].copy(), begins=self.clock[2] <= 1.0)
            self._learn_motion(first + k, times_s, poses)
            done += 1
            if self.backwards and self.misses > BACKWARDS_MISSES:
                return
        self.next_frame = first + len(frames)

    def _track_in_flight(
        self, frames: Frames, rows: NDArray[np.int64], times_s: Array, poses: ClipPoses, surprise_chi2: float = np.inf
    ) -> int:
        """Track as many frames, some rows of the clip, as the motion explains; returns how many."""
        if self.misses > 0 or len(self._rates_after_impact):
            return 0
        n = len(rows)
        found = PoseRows(
            np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 6)), np.empty((n, PARAMETERS, PARAMETERS)),
            np.empty((n, STATISTICS)), np.empty(n),
        )  # fmt: skip
        motion = MotionEstimate(self.motion, self.rotation, self.P, self.view.gravity_m_s2, self.clock)
        model = self.view.model(self.view.tracking_settings)
        limits = np.array([surprise_chi2, float(self.searches)])
        done = track_frames(frames, times_s[rows], model, self._occluders, motion, limits, found, self._work)
        poses.put_rows(rows[:done], PoseRows(*(values[:done] for values in found)))
        return int(done)

    # --- where the motion does not explain the picture ---

    def _pose_by_hypotheses(self, image: NDArray[np.float32], time_s: float) -> Pose | None:
        """The pose on one frame that the motion so far does not explain, or None if the die is lost or out of view."""
        frame_s, dt, self._candidates = time_s, time_s - float(self.clock[0]), []
        late = predicted_delay(self.view.rig, self.motion, dt, self.view.gravity_m_s2)
        time_s, dt = time_s + late, dt + late
        if self.clock[2] >= MIN_POSES_OF_FLIGHT:
            gyration2 = float(np.linalg.eigvalsh(self.view.die.tensor_kg_m2)[-1]) / self.view.die.mass_kg
            self._fastest_m_s = float(
                np.sqrt((self.motion[3:6] ** 2).sum() + gyration2 * (self.motion[6:9] ** 2).sum())
            )
        predicted, P = self.motion.copy(), self.P.copy()
        R = predict_motion(predicted, self.rotation, P, dt, self.view.gravity_m_s2)
        expected = _state(time_s, predicted, R)
        if share_in_view(self.view, expected.position_m, R) == 0.0:
            self.misses += 1
            return None
        best = self._best_hypothesis(image, expected, P)
        is_lost = best is None or not self._is_acceptable(best[0]) or not self._is_explained(best[0], expected, P)
        self.misses += is_lost
        if best is None or is_lost or self._is_doubtful(best[0], expected, P):
            better = best[0].cost - ACCEPTED_EXCESS_COST if best is not None and not is_lost else np.inf
            enough = min(self.usual_cost + ACCEPTED_EXCESS_COST, better)
            found = (
                self._initialised_again(image, frame_s, R, abs(dt), enough) if self._searches_now(expected) else None
            )
            if best is None or is_lost or found is not None:
                return found
        pose, start = best
        pose = replace(pose, rotation=nearest_equivalent_rotation(pose.rotation, R, self.view.symmetries))
        time_s = float(frame_s + self.view.exposure_delay_s(pose.position_m))
        self._update(pose, start, predicted, R, P, time_s, abs(dt) / (self.misses + 1))
        self._candidates = [pose, *self._candidates]
        return pose

    def _best_hypothesis(self, image: NDArray[np.float32], expected: State, P: Array) -> tuple[Pose, State] | None:
        """The pose that explains the picture best, and the initial state that led to it."""
        best: tuple[Pose, State] | None = None
        tried: list[tuple[Pose, State]] = []
        enough = self.usual_cost + SMALL_EXCESS_COST
        for pose, start in self._trials(image, expected, P):
            tried.append((pose, start))
            if best is None or pose.cost < best[0].cost - LEAST_IMPROVEMENT:
                best = pose, start
            if best[0].cost < enough:
                return best
        if best is None or not self.view.shows_surface(expected.position_m):
            return best
        # None of them has come to the end, or the light on other faces was another.
        tried.sort(key=lambda trial: (not self._is_acceptable(trial[0]), trial[0].cost))
        again = [(self._refined_anew(image, *trial), trial[1]) for trial in tried[:REFINED_ANEW]]
        found = [best, *((pose, start) for pose, start in again if pose is not None)]
        return min(found, key=lambda trial: (not self._is_acceptable(trial[0]), trial[0].cost))

    def _refined_anew(self, image: NDArray[np.float32], pose: Pose, start: State) -> Pose | None:
        """A pose refined from where a refinement ended, as if nothing were known of the light."""
        initial = pose_state(pose.position_m, pose.rotation, start.velocity_m_s, start.omega_rad_s)
        return _if_determined(refine_pose(self.view, image, initial, coarse=0, roughly=True))

    def _trials(self, image: NDArray[np.float32], expected: State, P: Array) -> Iterator[tuple[Pose, State]]:
        """Refined poses with the states that led to them: where the motion leads, then the hypotheses."""
        first = self._refined(image, expected, 1, motion_prior(P, self.view.settings))
        if first is not None:
            yield first, expected
        others = islice(self._other_states(expected), self.view.quality.max_hypotheses)
        if self.view.shows_surface(expected.position_m):
            others = islice(self._apart(self._surface_starts(image, [*others])), IMPACT_SURFACE_TRIALS)
        for state, coarse in others:
            pose = self._refined(image, state, coarse, None)
            if pose is not None:
                yield pose, state

    def _surface_starts(
        self, image: NDArray[np.float32], states: list[tuple[State, int]]
    ) -> Iterator[tuple[State, int]]:
        """The states from which the whole surface of a die is refined, which takes far longer than its edges: a few as they are,
        then where edges lead, the best first: edges have wrong optima."""
        yield from islice(self._apart(states), MOST_DIRECT)
        refined = [(self._refined(image, state, coarse, None, edges_alone=True), state) for state, coarse in states]
        known = [(pose, state) for pose, state in refined if pose is not None]
        costs = costs_on_one_window(self.view, image, [pose for pose, _ in known])
        for k in np.argsort(costs, kind="stable"):
            pose, state = known[k]
            yield replace(state, position_m=pose.position_m, quaternion=quat_from_matrix(pose.rotation)), 0

    def _apart(self, states: Iterable[tuple[State, int]]) -> Iterator[tuple[State, int]]:
        """Of states that draw nearly the same die the first."""
        kept: list[tuple[Array, Array]] = []
        for state, coarse in states:
            here = state.position_m, state.rotation
            if not any(same_picture(self.view, here, there, IMPACT_APART_EDGES) for there in kept):
                kept.append(here)
                yield state, coarse

    def _refined(
        self, image: NDArray[np.float32], start: State, coarse: int, prior: Array | None, edges_alone: bool = False
    ) -> Pose | None:
        """A pose refined from a state; None if the picture does not determine it."""
        initial = pose_state(start.position_m, start.rotation, start.velocity_m_s, start.omega_rad_s)
        pose = refine_pose(
            self.view,
            image,
            initial,
            coarse=coarse,
            prior=prior,
            roughly=True,
            edges_alone=edges_alone,
            work=self._work,
        )
        return _if_determined(pose)

    def _is_acceptable(self, pose: Pose) -> bool:
        """Whether the picture by itself supports a pose."""
        whole = share_in_view(self.view, pose.position_m, pose.rotation) == 1.0
        covariance = pose.covariance
        known = covariance is not None and float(np.sqrt(np.trace(covariance[3:, 3:]))) < KNOWN_RAD
        has_support = pose.support > (MIN_SUPPORT if whole else MIN_SUPPORT_CUT)
        return known and has_support and pose.cost < self.usual_cost + MAX_EXCESS_COST

    def _is_explained(self, pose: Pose, expected: State, P: Array) -> bool:
        """Whether something explains where the pose lies: the motion so far, a table near enough for an impact, or a picture that
        shows the die there beyond doubt. Poses of a half-hidden die are explained by none of these."""
        if self._is_as_predicted(pose, expected, P):
            return True
        reach, high, (far_m, _) = (
            self.view.reach_m,
            is_high(self.view, expected.position_m, expected.rotation, P),
            self._far(expected, P),
        )
        dt = expected.time_s - float(self.clock[0])
        speed = float(np.linalg.norm(expected.velocity_m_s)) + reach * float(np.linalg.norm(expected.omega_rad_s))
        moved = float(np.linalg.norm(pose.position_m - self.motion[:3]))
        fastest = FASTEST_FACTOR_BACKWARDS if self.backwards else FASTEST_FACTOR
        if moved > fastest * speed * abs(dt) + far_m:
            return False
        is_clear = pose.clear_share > CLEAR_SUPPORT
        if not high:
            whole = self.view.shows_surface(pose.position_m)
            allowed = SURFACE_EXCESS_SHARE * self.usual_cost if whole else SMALL_EXCESS_COST
            return is_clear or pose.cost < self.usual_cost + allowed
        return is_clear and self.misses >= LOST_FRAMES and pose.cost < self.usual_cost + ACCEPTED_EXCESS_COST

    def _is_as_predicted(self, pose: Pose, expected: State, P: Array) -> bool:
        """Whether a pose lies where the motion so far puts it."""
        off_m, (far_m, far_rad) = pose.position_m - expected.position_m, self._far(expected, P)
        distance = float(seen_distance_m(self.view.rig, pose.position_m, off_m, self.view.reach_m))
        return distance < far_m and float(angle_between(pose.rotation, expected.rotation)) < far_rad

    def _far(self, expected: State, P: Array) -> tuple[float, float]:
        """Distance [m] and angle [rad] from the prediction beyond which a pose belongs to another flight."""
        high = is_high(self.view, expected.position_m, expected.rotation, P)
        reach, rad = bounds_of_flight(high)
        sigmas = PREDICTED_SIGMAS * widest_sigma(P, 0), PREDICTED_SIGMAS * widest_sigma(P, 3)
        return max(reach * self.view.reach_m, sigmas[0]), max(rad, sigmas[1])

    def _other_states(self, expected: State) -> Iterator[tuple[State, int]]:
        """Other initial states, each with the level of coarseness of its refinement: from the last pose with the rates after an
        impact before it, after impacts on the low corners, the last pose, the expected one, and rotations about the last."""
        time_s = expected.time_s
        last = _state(float(self.clock[0]), self.motion, self.rotation)
        for rates in self._rates_after_impact:
            yield self._flight(replace(last, velocity_m_s=rates[:3], omega_rad_s=rates[3:])).at(time_s), 3
        yield from ((state, 3) for state in beyond_impacts(self.view.die, last, time_s, self.view.gravity_m_s2))
        yield State(time_s, last.position_m, last.quaternion, last.velocity_m_s, last.omega_rad_s), 4
        yield expected, 4
        half = self._flight(last).at(0.5 * (last.time_s + time_s)).position_m
        for axis in _AXES:
            q = quat_from_matrix(matrix_from_quat(quat_from_rotvec(TRIAL_TURN_RAD * axis)) @ last.rotation)
            yield State(time_s, half, q, np.zeros(3), np.zeros(3)), 4

    def _flight(self, state: State) -> Flight:
        return flight_from(self.view, state)

    def _is_doubtful(self, pose: Pose, expected: State, P: Array) -> bool:
        """Whether a pose explains its picture worse than those before, and no known motion supports it."""
        is_supported = self.clock[2] >= MIN_POSES_OF_FLIGHT and self._is_as_predicted(pose, expected, P)
        return not is_supported and pose.cost > self.usual_cost + ACCEPTED_EXCESS_COST

    def _searches_now(self, expected: State) -> bool:
        """Whether an initial pose is searched on this frame."""
        due = self.misses == 0 or self.misses >= self._next_search
        return self.searches and due and share_in_view(self.view, expected.position_m, expected.rotation) == 1.0

    def _initialised_again(
        self, image: NDArray[np.float32], time_s: float, R: Array, passed_s: float, enough: float
    ) -> Pose | None:
        """A new initial pose where the die was lost, some time after the last pose; None if none is clear and costs less than
        `enough`. Two on consecutive frames give the velocities."""
        last = _state(float(self.clock[0]), self.motion, self.rotation)
        found = [
            replace(pose, rotation=nearest_equivalent_rotation(pose.rotation, R, self.view.symmetries))
            for _, pose in pose_candidates(self.view, image)
            if self._is_acceptable(pose) and self._is_within_reach(pose, last, time_s - last.time_s)
        ]
        self._candidates = sorted(found, key=lambda pose: pose.cost)[:MOST_CANDIDATES]
        best = self._candidates[0] if found else None
        others = [pose for pose in self._candidates[1:] if best and self._leaves_open(best, pose)]
        clear = [pose for pose in self._candidates[:1] if pose.clear_share > CLEAR_SUPPORT and pose.cost < enough]
        if others or not clear:
            is_followed = bool(found) and len(self._surprising) < MIN_POSES_OF_FLIGHT - 1
            self._next_search = self.misses + (1 if is_followed else self._search_wait)
            self._search_wait = self._search_wait if is_followed else min(2 * self._search_wait, SEARCH_EVERY)
            return None
        pose = clear[0]
        exposed_s = float(time_s + self.view.exposure_delay_s(pose.position_m))
        rates, reach, rad = np.zeros(6), UNKNOWN_REACH, UNKNOWN_RAD
        if self.misses <= 1 and self.clock[2] == 1.0:
            dt, reach, rad = exposed_s - last.time_s, BOUNCED_REACH, BOUNCED_RAD
            turn = rotation_between(last.quaternion, quat_from_matrix(pose.rotation))
            rates = np.concatenate([pose.position_m - last.position_m, turn]) / dt
        self.motion = np.concatenate([pose.position_m, rates])
        self.rotation = pose.rotation.copy()
        self.P = initial_covariance(self.view, pose, passed_s / max(self.misses, 1), reach, rad)
        self.clock = np.array([exposed_s, self.usual_cost, 1.0])
        self._forget_loss()
        return pose

    def _learn_motion(self, k: int, times_s: Array, poses: ClipPoses) -> None:
        """Take the motion, where it is not known, from the poses that the last pictures show by themselves."""
        follows = bool(self._surprising) and abs(k - self._surprising[-1][0]) == 1
        self._surprising = [*(self._surprising if follows else []), (k, self._candidates)][-MIN_POSES_OF_FLIGHT:]
        if not self._candidates:
            self._surprising = []
        is_known = self.misses == 0 and self.clock[2] >= MIN_POSES_OF_FLIGHT
        if is_known or len(self._surprising) < MIN_POSES_OF_FLIGHT:
            return
        rows = [row for row, _ in self._surprising]
        fastest_m_s = min(self._fastest_m_s, FASTEST_M_S) * (FASTEST_FACTOR_BACKWARDS if self.backwards else 1.0)
        found = motion_of_poses(
            self.view, times_s[rows], [candidates for _, candidates in self._surprising], fastest_m_s
        )
        if found is None:
            return
        for row, pose in zip(rows, found.poses, strict=True):
            poses.put(row, pose, found.motion[3:])
        self.follow(found)

    def follow(self, found: MotionOfPoses) -> None:
        """Go on from a flight through poses of single pictures."""
        last, n = found.poses[-1], len(found.poses)
        frame_s = float(abs(found.time_s[-1] - found.time_s[0])) / (n - 1)
        self.motion, self.rotation = found.motion.copy(), last.rotation.copy()
        self.P = initial_covariance(self.view, last, frame_s, BOUNCED_REACH, BOUNCED_RAD)
        moving, turning = np.r_[0:3, 6:9], np.r_[3:6, 9:12]
        self.P[np.ix_(moving, turning)], self.P[np.ix_(turning, moving)] = 0.0, 0.0
        self.P[np.ix_(moving, moving)] = found.covariance
        self.clock = np.array([found.time_s[-1], self.usual_cost, float(n)])
        self._forget_loss()

    def _forget_loss(self) -> None:
        """The die is known again."""
        self.misses, self._rates_after_impact = 0, np.zeros((0, 6))
        self._next_search, self._search_wait = 1, 1

    def _leaves_open(self, best: Pose, other: Pose) -> bool:
        """Whether another pose of a picture leaves open which is right."""
        here, there = ((pose.position_m, pose.rotation) for pose in (best, other))
        return other.cost < best.cost + AMBIGUOUS_COST and not same_picture(self.view, here, there)

    def _is_within_reach(self, pose: Pose, last: State, dt: float) -> bool:
        """Whether the die can have come from the last pose to this one, as the camera sees it."""
        reach_m, fastest = self.view.reach_m, FASTEST_FACTOR_BACKWARDS if self.backwards else FASTEST_CENTRE_FACTOR
        moved_m = seen_distance_m(self.view.rig, pose.position_m, pose.position_m - last.position_m, reach_m)
        return (
            float(moved_m)
            < (fastest * self._fastest_m_s + self.view.gravity_m_s2 * abs(dt)) * abs(dt) + SEEN_REACH * reach_m
        )

    def _update(
        self, pose: Pose, start: State, predicted: Array, R: Array, P: Array, time_s: float, frame_s: float
    ) -> None:
        """Update the motion with the pose of this frame. If that lies far from the prediction, a new motion begins with the
        velocities of the initial state that led to it."""
        self.misses = 0
        count, ahead = float(self.clock[2]), MotionEstimate(predicted, R, P, self.view.gravity_m_s2, self.clock)
        leads_on = np.array_equal(start.velocity_m_s, predicted[3:6])
        known = MIN_POSES_OF_FLIGHT if leads_on else MIN_POSES_BEFORE_IMPACT
        if count >= known and leaves_flight(self.view, pose, ahead, float(self.searches)):
            last = _state(float(self.clock[0]), self.motion, self.rotation)
            self._rates_after_impact = different_rates(
                beyond_impacts(self.view.die, last, time_s, self.view.gravity_m_s2), frame_s
            )
            has_rates = np.any(start.velocity_m_s != 0.0)
            reach, rad = (BOUNCED_REACH, BOUNCED_RAD) if has_rates else (UNKNOWN_REACH, UNKNOWN_RAD)
            self.motion = np.concatenate([pose.position_m, start.velocity_m_s, start.omega_rad_s])
            self.rotation, self.P = pose.rotation.copy(), initial_covariance(self.view, pose, frame_s, reach, rad)
            count = 0.0
        else:
            motion, self._rates_after_impact = predicted, np.zeros((0, 6))
            self.rotation = update_motion(motion, R, P, pose.position_m, pose.rotation, pose.H, self.view.settings)
            self.motion, self.P = motion, P
        usual = self.usual_cost
        self.clock = np.array([time_s, usual + (pose.cost - usual) / USUAL_COST_FRAMES, count + 1.0])


_AXES = np.vstack(
    [
        np.eye(3),
        -np.eye(3),
        np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3.0),
    ]
)


def _state(time_s: float, motion: Array, rotation: Array) -> State:
    return State(time_s, motion[:3].copy(), quat_from_matrix(rotation), motion[3:6].copy(), motion[6:9].copy())


def _if_determined(pose: Pose) -> Pose | None:
    """A refined pose; None if the picture leaves a direction open or shows too little of the contour."""
    return None if pose.covariance is None or pose.contour_px < LEAST_CONTOUR_PX else pose
