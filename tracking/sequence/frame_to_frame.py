"""Following the die from frame to frame.

In flight the compiled `motion_filter.track_frames` predicts with the motion so far, refines and judges; it stops where picture
and motion tell different stories. Then, here, other starts compete: bounces of several strengths on each low corner, the last
pose, and turns about it; the one that explains the picture best is taken, and the chase goes on from there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, nearest_equivalent_rotation
from ...model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec
from ...model.throw import Flight, State
from ..footage import FrameSource
from ..picture import (
    PARAMETERS,
    STATISTICS,
    PoseRows,
    View,
    Workspace,
    new_workspace,
    share_in_view,
    with_occluder_mask,
)
from ..pose import ClipPoses, Pose, initial_poses, longest_stride, power_of_two, refine_pose
from ..throw import SMALL_MOVE_REACH, SMALL_TURN_RAD
from .motion_filter import ACCEPTED_EXCESS_COST, MotionEstimate, predict_motion, track_frames, update_motion

Array = NDArray[np.float64]
Frames = NDArray[Any]

UNKNOWN_REACH, UNKNOWN_RAD = 0.2, 0.12
"""How far the die may move (in units of its reach) and turn from one frame to the next where nothing is known of its
motion, one sigma: dice filmed well turn by 7 to 10 degrees a frame after a hard bounce."""
BOUNCED_REACH, BOUNCED_RAD = 0.07, 0.07
"""The same after a bounce whose strength is guessed."""
NEW_REACH, NEW_RAD = 0.14, np.radians(2.0)
"""A pose further than this from where the motion led belongs to a new flight."""
BELIEVED = 2.5
"""By how much a pose may cost more than usual and still be believed where nothing explains the picture better."""
PLAINLY = 0.05
"""A rival that costs no more than this above the usual ends the search for a better one."""
PLAIN_SUPPORT = 0.8
"""Share of the contour with a clear step that shows a die beyond doubt: a rod before it takes more away."""
BOUNCE_REACH = 0.35
"""Height of the lowest corner, in units of the die's reach, below which a bounce may have come between two frames."""
SEARCH_EVERY = 6
"""Frames without a pose until a fresh start is looked for."""
SETTLED, SURE_PX, SURPRISING = 20, 0.3, 30.0
"""Frames that must have been seen of a flight, or since a surprise, before some are left out: so many the motion remembers; how
sure it must be of where the next leap leads; and squared sigmas that poses behind a bounce lie away from there, and of honest
ones one in 25 000."""


class FrameTracker:
    """Follows the die through blocks of frames; the one place that remembers how it moved."""

    def __init__(
        self, view: View, motion: Array, rotation: Array, P: Array, clock: Array, unused: NDArray[np.bool_]
    ) -> None:
        self.view, self._occluders = with_occluder_mask(view)
        self.unused = unused
        self.motion, self.rotation, self.P, self.clock = motion, rotation, P, clock
        self.misses = 0
        self.next_frame = 0
        self.backwards = False
        self._longest, self._leaps_from, self._surprises = 1, 0, 0
        self._work: Workspace = new_workspace(view.shape, view.rig)

    @staticmethod
    def from_start(
        view: View, pose: Pose, times_s: Array, k: int, unused: NDArray[np.bool_], moving: Array | None = None
    ) -> FrameTracker:
        """A chase of which only the pose on frame k is known, or, as after a bounce, also about how the die moves: `moving` (6,),
        velocity [m/s] and spin [rad/s]. Frames that are `unused` (n,) are passed over."""
        near = times_s[max(k - 1, 0) : k + 2]
        frame_s = float(np.abs(np.diff(near)).mean()) if len(near) > 1 else 1.0
        reach, rad = (UNKNOWN_REACH, UNKNOWN_RAD) if moving is None else (BOUNCED_REACH, BOUNCED_RAD)
        P = _unsure(view, pose, frame_s, reach, rad)
        motion = np.concatenate([pose.position_m, np.zeros(6) if moving is None else moving])
        made = FrameTracker(view, motion, pose.rotation.copy(), P, np.array([times_s[k], pose.cost, 1.0]), unused)
        made.next_frame = k + 1
        return made

    def turned_back(self) -> FrameTracker:
        """The chase of the frames before those of this one, from what is known of the flight that it is in."""
        back = FrameTracker(
            self.view, self.motion.copy(), self.rotation.copy(), self.P.copy(), self.clock.copy(), self.unused
        )
        back.view, back._occluders = self.view, self._occluders
        back.backwards = True
        return back

    def to_the_end(
        self, source: FrameSource, seen: ClipPoses, reached: Callable[[int], None], *, all_frames: bool
    ) -> None:
        """Follow the die through the rest of a clip. Unless `all_frames` are wanted, those are left out over which little moves
        and the motion is sure: of a film far faster than the die is. After a surprise, as a bounce is one, all are looked at."""
        self._longest = 1 if all_frames else longest_stride(len(source))
        while self.next_frame < len(source):
            for block in source.blocks(self.next_frame):
                with block:
                    self.over(block.frames, source.times_s, block.first, seen)
                reached(self.next_frame)
                if self._leap(source.times_s) > 1:
                    break
            while (leap := self._leap(source.times_s)) > 1:
                self._leap_over(source, seen, leap)
                seen.frame_stride = self._longest
                reached(self.next_frame)
        seen.frame_stride = min(seen.frame_stride, self._longest)

    def _leap(self, times_s: Array) -> int:
        """From how many frames to look at one next: a power of two, so that multiples of a longer leap are some of a shorter. No
        more than the fastest flight so far allows: a die that rests at last must not seem filmed as fast as that."""
        k = self.next_frame
        if self._longest == 1 or self.misses > 0 or self.clock[2] < SETTLED or not self._leaps_from <= k < len(times_s):
            return 1
        frame_s, reach_m, camera = float(times_s[k] - times_s[k - 1]), self.view.reach_m, self.view.camera
        speed, spin = (float(np.linalg.norm(rate)) for rate in (self.motion[3:6], self.motion[6:9]))
        moved = max(speed * frame_s / (SMALL_MOVE_REACH * reach_m), spin * frame_s / SMALL_TURN_RAD, 1e-9)
        self._longest = power_of_two(min(self._longest, 1.0 / moved))
        blind_m, blind_rad = widest_sigma(self.P, 6), widest_sigma(self.P, 9)
        scale_px_per_m = camera.matrix[0, 0] / float(np.linalg.norm(self.motion[:3] - camera.centre_m))
        unsure_px = scale_px_per_m * (blind_m + reach_m * blind_rad) * frame_s
        return power_of_two(min(self._longest, SURE_PX / unsure_px))

    def _leap_over(self, source: FrameSource, seen: ClipPoses, leap: int) -> None:
        """Look at one frame in `leap`, some times, or until one surprises: from the one before on all are looked at then."""
        rows = np.arange(-(-self.next_frame // leap) * leap, len(source), leap)[: source.block_frames]
        rows = rows[~self.unused[rows]]
        done = 0
        if len(rows):
            frames = np.stack([source.frame(int(k)) for k in rows])
            done = self._in_flight(frames, rows, source.times_s, seen, SURPRISING)
        if done:
            self.next_frame, self._surprises = int(rows[done - 1]) + 1, 0
        if done < len(rows) or not len(rows):
            # What moves as no flight does, a die that rolls or rests, surprises again and again.
            last = int(rows[done]) if len(rows) else self.next_frame
            self._leaps_from = last + (SETTLED << self._surprises)
            self._surprises += 1

    def over(self, frames: Frames, times_s: Array, first: int, seen: ClipPoses) -> None:
        """Follow the die over frames (n, cameras, height, width), of which the first is frame `first` of the clip, and
        write what is seen; backwards from the last frame where the chase runs backwards."""
        order = np.flatnonzero(~self.unused[first : first + len(frames)])
        if self.backwards:
            order = order[::-1]
        else:
            order = order[first + order >= self.next_frame]
        done = 0
        while done < len(order):
            left = order[done:]
            # Contiguous either way, so that there is one compiled chase and not two; frames one after the other need no copy.
            in_a_row = left[-1] - left[0] == len(left) - 1
            some = np.ascontiguousarray(frames[left[0] : left[-1] + 1] if in_a_row else frames[left])
            done += self._in_flight(some, first + left, times_s, seen)
            if done == len(order):
                break
            k = int(order[done])
            found = self._resolved(np.asarray(frames[k], np.float32), float(times_s[first + k]))
            if found is not None:
                seen.put(first + k, found, self.motion[3:].copy())
            done += 1
            if self.backwards and self.misses > 3:
                return
        self.next_frame = first + len(frames)

    def _in_flight(
        self, frames: Frames, rows: NDArray[np.int64], times_s: Array, seen: ClipPoses, surprising: float = np.inf
    ) -> int:
        """As many frames, some rows of the clip, as the compiled chase can follow; how many."""
        if self.misses > 0:
            return 0
        n = len(rows)
        found = PoseRows(
            np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 6)), np.empty((n, PARAMETERS, PARAMETERS)),
            np.empty((n, STATISTICS)), np.empty(n),
        )  # fmt: skip
        motion = MotionEstimate(self.motion, self.rotation, self.P, self.clock)
        model = self.view.model(self.view.tracking_settings)
        done = track_frames(frames, times_s[rows], model, self._occluders, motion, surprising, found)
        seen.put_rows(rows[:done], PoseRows(*(values[:done] for values in found)))
        return int(done)

    # --- where flight and picture disagree ---

    def _resolved(self, image: NDArray[np.float32], time_s: float) -> Pose | None:
        """The pose on one frame that the motion so far does not explain, or None where the die is lost or out of view."""
        dt = time_s - float(self.clock[0])
        ahead, P = self.motion.copy(), self.P.copy()
        R = predict_motion(ahead, self.rotation, P, dt)
        expected = _state(time_s, ahead, R)
        if share_in_view(self.view, expected.position_m, R) == 0.0:
            self.misses += 1
            return None
        best = self._best(image, expected, time_s, P)
        if best is None or not self._believable(best[0]) or not self._explained(best[0], expected, P):
            self.misses += 1
            if self.misses % SEARCH_EVERY != SEARCH_EVERY - 1 or self.backwards:
                return None
            return self._found_again(image, time_s, R, abs(dt) / (self.misses + 1))
        pose, start = best
        pose = replace(pose, rotation=nearest_equivalent_rotation(pose.rotation, R, self.view.symmetries))
        self._remember(pose, start, ahead, R, P, time_s, abs(dt) / (self.misses + 1))
        return pose

    def _best(self, image: NDArray[np.float32], expected: State, time_s: float, P: Array) -> tuple[Pose, State] | None:
        """The pose that explains the picture best, with the start that led to it."""
        best: tuple[Pose, State] | None = None
        usual, settings = float(self.clock[1]), self.view.settings
        tight = (
            float(np.clip(4.0 * widest_sigma(P, 0), settings.tight_m, settings.loose_m)),
            float(np.clip(4.0 * widest_sigma(P, 3), settings.tight_rad, settings.loose_rad)),
        )
        loose = settings.loose_m, settings.loose_rad
        rivals = islice(self._rivals(expected, time_s), self.view.quality.max_hypotheses)
        for start, coarse, prior in ((expected, 1, tight), *((s, c, loose) for s, c in rivals)):
            pose = refine_pose(
                self.view, image, start.position_m, start.rotation, velocity_m_s=start.velocity_m_s,
                omega_rad_s=start.omega_rad_s, coarse=coarse, prior_position_m=prior[0], prior_rotation_rad=prior[1],
                roughly=True, work=self._work,
            )  # fmt: skip
            if pose.covariance is None or pose.contour_px < 20.0:
                continue
            if best is None or pose.cost < best[0].cost - 0.02:
                best = pose, start
            if best[0].cost < usual + PLAINLY:
                break
        return best

    def _believable(self, pose: Pose) -> bool:
        whole = share_in_view(self.view, pose.position_m, pose.rotation) == 1.0
        covariance = pose.covariance
        sure = covariance is not None and float(np.sqrt(np.trace(covariance[3:, 3:]))) < np.radians(6.0)
        return sure and pose.support > (0.45 if whole else 0.6) and pose.cost < float(self.clock[1]) + BELIEVED

    def _explained(self, pose: Pose, expected: State, P: Array) -> bool:
        """Whether something explains where the pose lies: the motion so far, a table near enough to bounce off, or a picture
        that shows the die there beyond doubt. A die half hidden shows poses that are none of these."""
        reach = self.view.reach_m
        off = float(np.linalg.norm(pose.position_m - expected.position_m))
        turned = float(np.arccos(np.clip(0.5 * (np.trace(pose.rotation @ expected.rotation.T) - 1.0), -1.0, 1.0)))
        far_m, far_rad = max(NEW_REACH * reach, 3.0 * widest_sigma(P, 0)), max(NEW_RAD, 3.0 * widest_sigma(P, 3))
        if off < far_m and turned < far_rad:
            return True
        lowest = float((expected.rotation @ self.view.die.solid.vertices.T)[2].min() + expected.position_m[2])
        whole = pose.support > PLAIN_SUPPORT
        if lowest < BOUNCE_REACH * reach:
            return whole or pose.cost < float(self.clock[1]) + PLAINLY
        return whole and pose.cost < float(self.clock[1]) + ACCEPTED_EXCESS_COST

    def _rivals(self, expected: State, time_s: float) -> Iterator[tuple[State, int]]:
        """Other starts: bounces on the low corners, the last pose, and turns about it."""
        last = _state(float(self.clock[0]), self.motion, self.rotation)
        if not self.backwards:
            yield from ((state, 3) for state in _bounced(self.view.die, last, time_s))
        yield State(time_s, last.position_m, last.quaternion, last.velocity_m_s, last.omega_rad_s), 4
        yield expected, 4
        half = Flight(last, np.inf).at(0.5 * (last.time_s + time_s)).position_m
        for axis in _TURNS:
            q = quat_from_matrix(matrix_from_quat(quat_from_rotvec(np.radians(6.0) * axis)) @ last.rotation)
            yield State(time_s, half, q, np.zeros(3), np.zeros(3)), 4

    def _found_again(self, image: NDArray[np.float32], time_s: float, R: Array, frame_s: float) -> Pose | None:
        """A fresh start after frames without a pose."""
        found = [
            pose
            for _, pose in initial_poses(self.view, image)
            if self._believable(pose)
            and pose.support > PLAIN_SUPPORT
            and pose.cost < float(self.clock[1]) + ACCEPTED_EXCESS_COST
        ]
        if not found:
            return None
        pose = replace(found[0], rotation=nearest_equivalent_rotation(found[0].rotation, R, self.view.symmetries))
        self.motion = np.concatenate([pose.position_m, np.zeros(6)])
        self.rotation, self.P = pose.rotation.copy(), _unsure(self.view, pose, frame_s, UNKNOWN_REACH, UNKNOWN_RAD)
        self.clock = np.array([time_s, pose.cost, 1.0])
        self.misses = 0
        return pose

    def _remember(
        self, pose: Pose, start: State, ahead: Array, R: Array, P: Array, time_s: float, frame_s: float
    ) -> None:
        """Carry the motion to this frame: corrected by the pose, or, where that lies far off, begun anew with the
        velocities of the start that led there."""
        self.misses = 0
        off = float(np.linalg.norm(pose.position_m - ahead[:3]))
        turned = float(np.arccos(np.clip(0.5 * (np.trace(pose.rotation @ R.T) - 1.0), -1.0, 1.0)))
        count = float(self.clock[2])
        if count >= 3 and (off > NEW_REACH * self.view.reach_m or turned > NEW_RAD):
            guessed = np.any(start.velocity_m_s != 0.0)
            reach, rad = (BOUNCED_REACH, BOUNCED_RAD) if guessed else (UNKNOWN_REACH, UNKNOWN_RAD)
            self.motion = np.concatenate([pose.position_m, start.velocity_m_s, start.omega_rad_s])
            self.rotation, self.P = pose.rotation.copy(), _unsure(self.view, pose, frame_s, reach, rad)
            count = 0.0
        else:
            motion = ahead
            self.rotation = update_motion(motion, R, P, pose.position_m, pose.rotation, pose.H, self.view.settings)
            self.motion, self.P = motion, P
        usual = float(self.clock[1])
        self.clock = np.array([time_s, usual + (pose.cost - usual) / 8.0, count + 1.0])


_TURNS = np.vstack(
    [
        np.eye(3),
        -np.eye(3),
        np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3.0),
    ]
)


def _state(time_s: float, motion: Array, rotation: Array) -> State:
    return State(time_s, motion[:3].copy(), quat_from_matrix(rotation), motion[3:6].copy(), motion[6:9].copy())


def widest_sigma(P: Array, first: int) -> float:
    """The largest standard deviation of three numbers of a motion. Carried back to where it was known their variances cancel, and
    rounding may leave less than nothing."""
    return float(np.sqrt(max(np.diag(P)[first : first + 3].max(), 0.0)))


def _unsure(view: View, pose: Pose, frame_s: float, reach: float, rad: float) -> Array:
    """Covariance (12, 12) of a motion whose velocities are guesses: so far a frame, in units of the die's reach and in
    radians."""
    P = np.zeros((12, 12))
    known = pose.covariance
    P[:6, :6] = 4.0 * known if known is not None else 0.0
    P[6:9, 6:9] = np.eye(3) * (reach * view.reach_m / frame_s) ** 2
    P[9:, 9:] = np.eye(3) * (rad / frame_s) ** 2
    return P


def _bounced(die: Die, last: State, time_s: float) -> Iterator[State]:
    """Where the die would be after a bounce between the last frame and this one: the paper's smooth impact with several
    restitutions on each corner that could reach the table."""
    dt = time_s - last.time_s
    corners = last.rotation @ die.solid.vertices.T
    heights = corners[2] + last.position_m[2]
    sink = np.minimum(last.velocity_m_s[2] + np.cross(last.omega_rad_s, corners.T)[:, 2], 0.0) * dt
    edge = die.solid.edge_m
    for i in np.flatnonzero(heights + 1.5 * sink < 0.12 * edge):
        arm = corners[:, i]
        normal = last.velocity_m_s[2] + np.cross(last.omega_rad_s, arm)[2]
        if normal >= 0:
            continue
        lever = np.cross(arm, [0.0, 0.0, 1.0])
        for chi in (0.5, 0.15, 0.85):
            impulse = -(1.0 + chi) * normal / (1.0 / die.mass_kg + lever @ lever / die.inertia_kg_m2)
            velocity = last.velocity_m_s + np.array([0.0, 0.0, impulse / die.mass_kg])
            omega = last.omega_rad_s + impulse * lever / die.inertia_kg_m2
            for share in (0.2, 0.8):
                touch = Flight(last, np.inf).at(last.time_s + (1.0 - share) * dt)
                yield Flight(State(touch.time_s, touch.position_m, touch.quaternion, velocity, omega), np.inf).at(
                    time_s
                )
