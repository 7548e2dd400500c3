"""From a clip to a track: the die found, followed through its bounces, and every frame's pose refined.

First pass: from the first frame on which the die is wholly seen, forwards to the end and backwards to where it came
in. Each pose is refined from where the motion so far leads. Where the picture does not agree, or the die is near the
table, other starts compete: bounces of several strengths on each low corner, the last pose, and turns about it; the one
that explains the picture best is taken. Second pass: the bounces are found, each flight is fitted, the lens blur is
estimated, and every frame is refined once more from its flight, which brings back frames that the first pass lost or
got wrong. The poses are those of single frames: nothing is smoothed here (`smooth`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..model.motion import GRAVITY_M_S2, Flight, State, Throw
from ..model.rotations import (
    continuous_sign,
    matrix_from_quat,
    quat_from_matrix,
    quat_from_rotvec,
    rotation_between,
    rotvec_from_quat,
)
from ..model.solids import Die
from .background import estimate_background
from .bounces import NoFlightError, measure_throw
from .camera import Camera
from .clip import Clip, Frame
from .hints import HandStart, excluded_rows
from .joined import Sightings, fit_flight, transition
from .pose import Pose, View, labelled_like, make_view, outline_box, picture_score, refine_pose, share_in_view
from .segment import background_noise
from .start import die_blobs, find_start
from .start_by_hand import start_by_hand
from .track import ABSENT, LOST, TRACKED, Track

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Progress = Callable[[int, int], None]

FIRST_BLUR_PX = 0.7
"""Lens blur until it is estimated."""
BLURS_PX = (0.35, 0.5, 0.65, 0.8, 1.0, 1.25, 1.6, 2.0)
TRIAL_FRAMES = 8
"""Frames that a start must be followed over before it is believed."""
START_FRAMES = 14
"""Frames on which a start is looked for, a few frames apart, before the clip is given up."""
HISTORY = 20
"""Frames of the same flight that say where the next pose will be."""
PRIOR_SIGMAS = 4.0
"""The prior of a refinement is this many times wider than what the flight so far predicts."""
LOOSE_M, LOOSE_RAD, TIGHT_M, TIGHT_RAD = 3e-3, 0.1, 4e-4, 0.012
"""Bounds of that prior: a bounce must not be held back by it, nor a face seen alone be free to tip over."""
SURE_SUPPORT, FAIR_SUPPORT = 0.85, 0.6
"""Share of the contour that must show a clear step over a trial for a start to be taken at once; where no frame offers
that, as with a die of little contrast, the best start above the second is taken."""
CHI2_MEDIAN = 5.348
"""Median of chi-square with six degrees of freedom."""
KEPT_BYTES = 200_000_000
"""Frames before the start are kept up to this size for the backward pass; older ones are read again."""


class NoDieError(ValueError):
    """No die was found in the clip."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """One frame's pose with the motion that was assumed for its blur."""

    time_s: float
    pose: Pose
    velocity_m_s: Array
    omega_rad_s: Array
    cost: float
    """How badly the picture is explained; comparable between poses of one frame only."""

    @property
    def state(self) -> State:
        return State(
            self.time_s, self.pose.position_m, quat_from_matrix(self.pose.rotation), self.velocity_m_s, self.omega_rad_s
        )


def follow(
    clip: Clip,
    camera: Camera,
    die: Die,
    *,
    background: NDArray[np.float32] | None = None,
    exposure_s: float | None = None,
    start: HandStart | None = None,
    excluded: Sequence[tuple[int, int]] = (),
    progress: Progress | None = None,
) -> Track:
    """Track a die through a clip: a pose with covariance for every frame on which it can be known.

    `background` (height, width) is a frame without the die, estimated from the clip where it is None. `start` is a first
    pose by hand. `excluded` are ranges (first, stop) of frame numbers whose pictures are not used: they are lost. `progress`
    is called with frames done and frames to do. Raises ValueError where camera, background and clip differ in size, and
    NoDieError where no die was found.
    """
    _check_sizes(clip, camera, background)
    if background is None:
        background = estimate_background(clip)
    report = _Reporter(progress, 2 * len(clip))
    sample = [_grey(clip.frame(k)) for k in np.unique(np.linspace(0, len(clip) - 1, 12).astype(int))]
    noise = background_noise(sample, np.asarray(background, np.float32))
    view = make_view(camera, die, np.asarray(background, np.float32), noise, exposure_s, FIRST_BLUR_PX)
    unused = excluded_rows(excluded, clip.first_frame, len(clip))
    seen = _first_pass(view, clip, report, start, unused)
    throw = _measured(view, clip, seen)
    if throw is not None and any(impact.contact == "unresolved" for impact in throw.impacts):
        seen = _labelled_across(view, seen, throw)
        throw = _measured(view, clip, seen)
    view = replace(view, blur_px=_lens_blur(view, clip, seen))
    report.at_least(len(clip))
    poses = [
        None if k in unused else _settled(view, _grey(frame), float(t), seen[k], throw)
        for k, (frame, t) in enumerate(zip(report.over(clip.frames()), clip.times_s, strict=False))
    ]
    return _calibrated(_track(clip, view, poses, throw), die)


def _check_sizes(clip: Clip, camera: Camera, background: NDArray[np.float32] | None) -> None:
    if (clip.width_px, clip.height_px) != (camera.width_px, camera.height_px):
        raise ValueError(
            f"the clip is {clip.width_px} × {clip.height_px} pixels and the camera "
            f"{camera.width_px} × {camera.height_px}: give the camera of this clip"
        )
    if background is not None and background.shape != (clip.height_px, clip.width_px):
        raise ValueError(
            f"the background is {background.shape[1]} × {background.shape[0]} pixels and the clip "
            f"{clip.width_px} × {clip.height_px}: give a frame of this clip without the die"
        )


def _grey(frame: Frame) -> Image:
    return np.ascontiguousarray(frame, np.float32)


# --- the first pass ---------------------------------------------------------------------------------------------------


def _first_pass(
    view: View, clip: Clip, report: _Reporter, by_hand: HandStart | None, unused: frozenset[int]
) -> list[Sighting | None]:
    """A pose for every frame that can be followed from the start."""
    times = clip.times_s
    ahead = _Ahead(report.over(clip.frames()))
    start = (
        _find_beginning(view, ahead, times, unused)
        if by_hand is None
        else _begin_by_hand(view, ahead, clip, by_hand, unused)
    )
    seen: list[Sighting | None] = [None] * len(clip)
    if start is None:
        raise NoDieError(
            f"no die was found in {len(clip)} frames: look at the clip, the background and the [die] shape and edge"
        )
    index, chain = start
    for offset, sighting in enumerate(chain):
        seen[index + offset] = sighting
    before = _Earlier(clip, ahead.past, ahead.past_start)
    history = [s for s in chain if s is not None]
    chase = _Chase(view, history)
    for k in range(index + len(chain), len(clip)):
        image = ahead.image(k)
        if image is None:
            break
        if k not in unused:
            seen[k] = chase.step(image, float(times[k]))
        ahead.forget(k)
    chase = _Chase(view, history[::-1], backwards=True)
    for k in range(index - 1, -1, -1):
        if k not in unused:
            seen[k] = chase.step(before.image(k), float(times[k]))
        if chase.misses > 3:
            break
    return seen


def _begin_by_hand(
    view: View, ahead: _Ahead, clip: Clip, by_hand: HandStart, unused: frozenset[int]
) -> tuple[int, list[Sighting | None]]:
    """The frame that a person named, with the frames over which the pose given there was followed."""
    k = by_hand.frame - clip.first_frame
    image = ahead.image(k) if 0 <= k < len(clip) and k not in unused else None
    if image is None:
        last = clip.first_frame + len(clip) - 1
        raise ValueError(
            f"start.frame = {by_hand.frame}: wanted a frame of the clip ({clip.first_frame} to {last}), none that is excluded"
        )
    return k, _trial(view, ahead, clip.times_s, k, start_by_hand(view, image, by_hand), np.inf, unused)


def _find_beginning(
    view: View, ahead: _Ahead, times: Array, unused: frozenset[int]
) -> tuple[int, list[Sighting | None]] | None:
    """The first frame on which the die is wholly seen, with the frames over which the best start was followed."""
    tried = 0
    k = 0
    spare: tuple[float, int, list[Sighting | None]] | None = None
    while tried < START_FRAMES:
        image = ahead.image(k)
        if image is None:
            break
        if k in unused or not die_blobs(view, image):
            k += 1
            continue
        tried += 1
        best: tuple[float, list[Sighting | None]] | None = None
        for _, pose in find_start(view, image):
            chain = _trial(view, ahead, times, k, pose, best[0] if best else np.inf, unused)
            alive = [s for s in chain if s is not None]
            whole = len(alive) >= min(TRIAL_FRAMES, len(times) - k) - 1
            if whole and _steady(view, alive):
                cost = float(np.mean([s.cost for s in alive]))
                if best is None or cost < best[0]:
                    best = cost, chain
        if best is not None:
            support = float(np.mean([s.pose.support for s in best[1] if s is not None]))
            if support > SURE_SUPPORT:
                return k, best[1]
            if spare is None or support > spare[0]:
                spare = support, k, best[1]
        # Ever wider apart: a shadow alone may fill many frames before the die that casts it comes into view.
        k += 4 + tried
    return spare[1:] if spare is not None and spare[0] > FAIR_SUPPORT else None


def _trial(
    view: View, ahead: _Ahead, times: Array, k: int, pose: Pose, to_beat: float, unused: frozenset[int]
) -> list[Sighting | None]:
    """Follow one start for a few frames, and no further once it explains them clearly worse than another start did."""
    image = ahead.image(k)
    assert image is not None
    first = Sighting(float(times[k]), pose, np.zeros(3), np.zeros(3), _cost(view, image, pose))
    chain: list[Sighting | None] = [first]
    costs = [first.cost]
    chase = _Chase(view, [first])
    for j in range(k + 1, min(k + TRIAL_FRAMES, len(times))):
        image = ahead.image(j)
        if image is None:
            break
        seen = None if j in unused else chase.step(image, float(times[j]))
        chain.append(seen)
        costs += [seen.cost] if seen is not None else []
        if chase.misses > 1 or (len(costs) > 3 and np.mean(costs) > to_beat + 0.3):
            break
    return chain


def _steady(view: View, alive: Sequence[Sighting]) -> bool:
    """Whether the poses move as a die in flight does: a parabola within a tenth of an edge and a constant spin within
    1.5 degrees. A wrong start jumps about, and so does the pose drawn into a shadow."""
    if len(alive) < 3:
        return False
    middle = alive[len(alive) // 2]
    t = np.array([s.time_s for s in alive]) - middle.time_s
    fall = np.array([s.pose.position_m for s in alive]) + np.outer(0.5 * GRAVITY_M_S2 * t * t, [0.0, 0.0, 1.0])
    q = quat_from_matrix(np.array([s.pose.rotation for s in alive]))
    turns = rotation_between(quat_from_matrix(middle.pose.rotation), q)
    solid = view.die.solid
    edge = solid.edge_m
    for values, allowed in ((fall, 0.1 * edge), (turns, np.radians(1.5))):
        left = values - np.stack([np.ones_like(t), t], 1) @ np.polynomial.polynomial.polyfit(t, values, 1)
        if float(np.sqrt((left**2).sum(1).mean())) > allowed:
            return False
    return True


class _Chase:
    """Follows the die from frame to frame; the one place that remembers where it was."""

    def __init__(self, view: View, history: Sequence[Sighting], backwards: bool = False) -> None:
        self.view = view
        self.history = list(history)[-HISTORY:]
        self.costs = [s.cost for s in history]
        self.backwards = backwards
        self.misses = 0

    def step(self, image: Image, time_s: float) -> Sighting | None:
        """The pose on the next frame, or None where it is lost or out of view."""
        motion, sigma_m, sigma_rad = self._motion(time_s)
        expected = Flight(motion, np.inf).at(time_s)
        if share_in_view(self.view, expected.position_m, expected.rotation) == 0.0:
            self.misses += 1
            return None
        sure = len(self.history) >= 3
        best = self._refined(image, expected, 1 if sure else 4, sigma_m, sigma_rad)
        if not self._agrees(best, expected):
            for start, coarse in self._rivals(expected, time_s):
                other = self._refined(image, start, coarse)
                if other is not None and (best is None or other.cost < best.cost - 0.02):
                    best = other
        if best is None or not self._believable(best):
            self.misses += 1
            if self.misses % 6 == 5 and not self.backwards:
                best = self._found_again(image, time_s)
                if best is not None and self._believable(best):
                    best = self._labelled(best, expected)
                    self.history, self.costs, self.misses = [best], [best.cost], 0
                    return best
            return None
        best = self._labelled(best, expected)
        self._remember(best, expected)
        return best

    def _labelled(self, seen: Sighting, expected: State) -> Sighting:
        """The same picture under the labelling that continues the motion: a die is only relabelled by continuity."""
        turned = labelled_like(self.view, seen.pose.rotation, expected.rotation)
        return replace(seen, pose=replace(seen.pose, rotation=turned))

    def _motion(self, time_s: float) -> tuple[State, float, float]:
        """The motion of the flight so far, each frame weighted by what its own pixels say, so that a direction which
        the last frames leave open is carried on from those before; and how far from it the pose may be at `time_s`,
        position [m] and turn [rad]."""
        if len(self.history) < 3:
            last = self.history[-1].state
            if len(self.history) == 2:
                first = self.history[0].state
                dt = last.time_s - first.time_s
                fall = np.array([0.0, 0.0, 0.5 * GRAVITY_M_S2 * dt])
                velocity = (last.position_m - first.position_m) / dt - fall
                omega = rotation_between(first.quaternion, last.quaternion) / dt
                last = State(last.time_s, last.position_m, last.quaternion, velocity, omega)
            return last, LOOSE_M, LOOSE_RAD
        covariance = np.array([np.linalg.inv(s.pose.information) for s in self.history])
        seen = Sightings.from_poses(
            np.array([s.time_s for s in self.history]),
            np.array([s.pose.position_m for s in self.history]),
            quat_from_matrix(np.array([s.pose.rotation for s in self.history])),
            covariance,
        )
        order = np.argsort(seen.time_s)
        state, C, left = fit_flight(seen.rows(order))
        misfit = max(1.0, left / max(6 * len(order) - 12, 1))
        M = transition(Flight(state, np.inf), time_s)
        P = (M @ C @ M.T)[:6, :6] * misfit
        sigma_m, sigma_rad = (
            float(np.sqrt(np.linalg.eigvalsh(P[:3, :3])[-1])),
            float(np.sqrt(np.linalg.eigvalsh(P[3:, 3:])[-1])),
        )
        return (
            state,
            float(np.clip(PRIOR_SIGMAS * sigma_m, TIGHT_M, LOOSE_M)),
            float(np.clip(PRIOR_SIGMAS * sigma_rad, TIGHT_RAD, LOOSE_RAD)),
        )

    def _refined(
        self, image: Image, start: State, coarse: int, sigma_m: float | None = None, sigma_rad: float | None = None
    ) -> Sighting | None:
        pose = refine_pose(
            self.view, image, start.position_m, start.rotation, velocity_m_s=start.velocity_m_s,
            omega_rad_s=start.omega_rad_s, coarse=coarse, prior_position_m=sigma_m or LOOSE_M,
            prior_rotation_rad=sigma_rad or LOOSE_RAD,
        )  # fmt: skip
        if pose.covariance is None or pose.contour_px < 20.0:
            return None
        return Sighting(start.time_s, pose, start.velocity_m_s, start.omega_rad_s, _cost(self.view, image, pose))

    def _agrees(self, seen: Sighting | None, expected: State) -> bool:
        """Whether the picture and the motion so far tell the same story."""
        if seen is None:
            return False
        turned = _angle(seen.pose.rotation, expected.rotation)
        moved = float(np.linalg.norm(seen.pose.position_m - expected.position_m))
        usual = float(np.median(self.costs[-8:]))
        # Before the motion is known the next pose may lie as far off as a die turns in one frame.
        far_rad, far_m = (np.radians(2.0), 2e-3) if len(self.history) >= 3 else (np.radians(9.0), 4e-3)
        return turned < far_rad and moved < far_m and seen.cost < usual + 0.35

    def _believable(self, seen: Sighting) -> bool:
        usual = float(np.median(self.costs[-8:])) if self.costs else seen.cost
        whole = share_in_view(self.view, seen.pose.position_m, seen.pose.rotation) == 1.0
        covariance = seen.pose.covariance
        sure = covariance is not None and float(np.sqrt(np.trace(covariance[3:, 3:]))) < np.radians(6.0)
        return sure and seen.pose.support > (0.45 if whole else 0.6) and seen.cost < usual + 2.5

    def _rivals(self, expected: State, time_s: float) -> Iterator[tuple[State, int]]:
        """Other starts: bounces on the low corners, the last pose, and turns about it."""
        motion, _, _ = self._motion(time_s)
        last = Flight(motion, np.inf).at(self.history[-1].time_s)
        if not self.backwards:
            yield from ((state, 3) for state in _bounced(self.view.die, last, time_s))
        still = State(time_s, last.position_m, last.quaternion, last.velocity_m_s, last.omega_rad_s)
        yield still, 4
        yield expected, 4
        base = last.rotation
        half = Flight(last, np.inf).at(0.5 * (last.time_s + time_s)).position_m
        for axis in np.vstack([np.eye(3), -np.eye(3), _DIAGONALS]):
            q = quat_from_matrix(matrix_from_quat(quat_from_rotvec(np.radians(6.0) * axis)) @ base)
            yield State(time_s, half, q, np.zeros(3), np.zeros(3)), 4

    def _found_again(self, image: Image, time_s: float) -> Sighting | None:
        """A fresh start after frames without a pose."""
        found = find_start(self.view, image)
        if not found:
            return None
        pose = found[0][1]
        return Sighting(time_s, pose, np.zeros(3), np.zeros(3), _cost(self.view, image, pose))

    def _remember(self, seen: Sighting, expected: State) -> None:
        turned = _angle(seen.pose.rotation, expected.rotation)
        moved = float(np.linalg.norm(seen.pose.position_m - expected.position_m))
        if self.history and (turned > np.radians(2.0) or moved > 2e-3) and len(self.history) >= 3:
            # A new flight: what came before says nothing about its velocities, the rival that won may.
            self.history = [seen]
        else:
            self.history = [*self.history, seen][-HISTORY:]
        self.costs = [*self.costs, seen.cost][-16:]
        self.misses = 0


_DIAGONALS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3.0)


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
        for chi in (0.15, 0.5, 0.85):
            impulse = -(1.0 + chi) * normal / (1.0 / die.mass_kg + lever @ lever / die.inertia_kg_m2)
            velocity = last.velocity_m_s + np.array([0.0, 0.0, impulse / die.mass_kg])
            omega = last.omega_rad_s + impulse * lever / die.inertia_kg_m2
            for share in (0.2, 0.8):
                touch = Flight(last, np.inf).at(last.time_s + (1.0 - share) * dt)
                yield Flight(State(touch.time_s, touch.position_m, touch.quaternion, velocity, omega), np.inf).at(
                    time_s
                )


def _cost(view: View, image: Image, pose: Pose) -> float:
    """How badly a pose explains its surroundings, edges and faces together. The window is that of the pose's own
    outline, so rivals near each other see the same pixels."""
    box = outline_box(view, pose.position_m, pose.rotation, 8.0)
    if box is None:
        return np.inf
    stride = max(1, int(np.sqrt((box[2] - box[0]) * (box[3] - box[1]) / 2500)))
    score, _ = picture_score(view, image, box, pose.position_m, pose.rotation, stride)
    return score + 2.0 * (1.0 - pose.support) + 10.0 * pose.unexplained


def _angle(a: Array, b: Array) -> float:
    return float(np.linalg.norm(rotvec_from_quat(quat_from_matrix(a @ b.T))))


# --- the second pass --------------------------------------------------------------------------------------------------


def _measured(view: View, clip: Clip, seen: Sequence[Sighting | None]) -> Throw | None:
    """Flights of the first pass, from the frames that show the die whole; None where they are too few to measure any."""
    whole = [
        s.pose if s is not None and share_in_view(view, s.pose.position_m, s.pose.rotation) == 1.0 else None
        for s in seen
    ]
    try:
        return measure_throw(_as_track(clip, whole), view.die)
    except NoFlightError:
        return None


def _labelled_across(view: View, seen: Sequence[Sighting | None], throw: Throw) -> list[Sighting | None]:
    """The sightings with one labelling throughout: where contacts follow each other too fast for the poses between them
    to be sure, each flight takes the labelling that turns least from the flight before."""
    out = list(seen)
    relabel = np.eye(3)
    for k, impact in enumerate(throw.impacts):
        before = throw.flights[k].at(impact.time_s).rotation @ relabel
        after = throw.flights[k + 1].at(impact.time_s).rotation
        relabel = after.T @ labelled_like(view, after, before)
        end = throw.impacts[k + 1].time_s if k + 1 < len(throw.impacts) else np.inf
        for j, s in enumerate(seen):
            if s is not None and impact.time_s < s.time_s <= end:
                out[j] = replace(s, pose=replace(s.pose, rotation=s.pose.rotation @ relabel))
    return out


def _lens_blur(view: View, clip: Clip, seen: Sequence[Sighting | None]) -> float:
    """The blur that leaves least noise on a dozen frames spread over the track, each refined anew for every trial."""
    have = [k for k, s in enumerate(seen) if s is not None]
    picked = [have[int(i)] for i in np.unique(np.linspace(0, len(have) - 1, min(12, len(have))))]
    noise = np.zeros((len(BLURS_PX), len(picked)))
    for j, k in enumerate(picked):
        image, s = _grey(clip.frame(k)), seen[k]
        assert s is not None
        for i, blur in enumerate(BLURS_PX):
            trial = refine_pose(
                replace(view, blur_px=blur), image, s.pose.position_m, s.pose.rotation, velocity_m_s=s.velocity_m_s,
                omega_rad_s=s.omega_rad_s, coarse=0,
            )  # fmt: skip
            noise[i, j] = trial.log_noise
    level = np.median(noise - noise.min(axis=0), axis=1)
    best = int(np.clip(np.argmin(level), 1, len(BLURS_PX) - 2))
    x, y = np.array(BLURS_PX[best - 1 : best + 2]), level[best - 1 : best + 2]
    a, b, _ = np.polyfit(x, y, 2)
    return float(np.clip(-b / (2.0 * a), x[0], x[2])) if a > 0 else float(BLURS_PX[int(np.argmin(level))])


def _settled(view: View, image: Image, time_s: float, first: Sighting | None, throw: Throw | None) -> Pose | None:
    """The final pose of one frame: refined from its flight, and from the first pass where that lies elsewhere."""
    starts = [throw.at(time_s)] if throw is not None else []
    if first is not None and (not starts or _apart(view, starts[0], first.pose)):
        starts.append(first.state)
    found = [pose for start in starts if (pose := _settled_from(view, image, start)) is not None]
    if not found:
        return None
    best = min(found, key=lambda pose: _cost(view, image, pose))
    return replace(best, rotation=labelled_like(view, best.rotation, starts[0].rotation))


def _apart(view: View, start: State, pose: Pose) -> bool:
    """Whether a pose lies further from a start than a refinement is sure to cover."""
    moved = float(np.linalg.norm(pose.position_m - start.position_m))
    return _angle(pose.rotation, start.rotation) > np.radians(1.5) or moved > 0.1 * view.reach_m


def _settled_from(view: View, image: Image, start: State) -> Pose | None:
    """The pose near a start, or None where the pixels do not bear it out."""
    if share_in_view(view, start.position_m, start.rotation) < 0.3:
        return None
    pose = refine_pose(
        view, image, start.position_m, start.rotation, velocity_m_s=start.velocity_m_s, omega_rad_s=start.omega_rad_s,
        coarse=1,
    )  # fmt: skip
    whole = share_in_view(view, pose.position_m, pose.rotation) == 1.0
    gone = float(np.linalg.norm(pose.position_m - start.position_m)) > 0.5 * view.reach_m
    if gone or _angle(pose.rotation, start.rotation) > np.radians(6.0) or pose.contour_px < 20.0:
        return None
    if pose.covariance is None or pose.support < (0.45 if whole else 0.6):
        return None
    return pose if float(np.sqrt(np.trace(pose.covariance[3:, 3:]))) < np.radians(6.0) else None


def _as_track(clip: Clip, poses: Sequence[Pose | None]) -> Track:
    """A track of the frames that have a pose; the others are lost."""
    n = len(clip)
    position, quaternion = np.full((n, 3), np.nan), np.full((n, 4), np.nan)
    covariance = np.full((n, 6, 6), np.nan)
    status = np.full(n, LOST, dtype="<U7")
    for k, pose in enumerate(poses):
        known = pose.covariance if pose is not None else None
        if pose is None or known is None:
            continue
        position[k], quaternion[k], covariance[k] = pose.position_m, quat_from_matrix(pose.rotation), known
        status[k] = TRACKED
    frames = clip.first_frame + np.arange(n)
    return Track(frames, np.asarray(clip.times_s, float), position, continuous_sign(quaternion), covariance, status)


def _track(clip: Clip, view: View, poses: Sequence[Pose | None], throw: Throw | None) -> Track:
    """The final table: frames without a pose are absent where the motion leads out of view, or lost."""
    track = _as_track(clip, poses)
    status = track.status.copy()
    for k in np.flatnonzero(status == LOST):
        if throw is None:
            continue
        state = throw.at(float(track.time_s[k]))
        if share_in_view(view, state.position_m, state.rotation) == 0.0:
            status[k] = ABSENT
    return replace(track, status=status)


def _calibrated(track: Track, die: Die) -> Track:
    """The track with its covariances scaled to the scatter of the poses about their own flights.

    Grain and shading on a die's faces are alike from pixel to pixel, so that single poses scatter more (usually about
    twice as much) than the noise of independent pixels says. The factor is one number for the whole clip, from the
    median, and never below one. What shifts all poses alike, as an error of the lens blur does, it cannot show.
    """
    try:
        throw = measure_throw(track, die)
    except NoFlightError:
        return track
    use = np.flatnonzero(track.tracked)
    p, q = throw.poses(track.time_s[use])
    miss = np.concatenate([track.position_m[use] - p, rotation_between(q, track.quaternion[use])], axis=1)
    squared = np.einsum("ni,nij,nj->n", miss, np.linalg.inv(track.covariance[use]), miss)
    factor = max(1.0, float(np.median(squared)) / CHI2_MEDIAN)
    return replace(track, covariance=track.covariance * factor)


# --- frames -----------------------------------------------------------------------------------------------------------


class _Ahead:
    """A window on a clip read once from front to back: a few frames ahead, and those before the start."""

    def __init__(self, frames: Iterable[Frame]) -> None:
        self._frames = iter(frames)
        self._images: dict[int, Image] = {}
        self._next = 0
        self.past: list[Frame] = []
        self.past_start = 0
        self._started = False

    def image(self, k: int) -> Image | None:
        """Frame k as float32; None behind the end."""
        while self._next <= k:
            frame = next(self._frames, None)
            if frame is None:
                return None
            self._images[self._next] = _grey(frame)
            if not self._started:
                self.past.append(frame)
                if sum(f.nbytes for f in self.past[:1]) * len(self.past) > KEPT_BYTES:
                    self._images.pop(self.past_start, None)
                    self.past.pop(0)
                    self.past_start += 1
            self._next += 1
        kept = self._images.get(k)
        return kept if kept is not None else _grey(self.past[k - self.past_start])

    def forget(self, k: int) -> None:
        """Frames up to k are not asked for again, and from here on none is kept for the backward pass."""
        self._started = True
        for old in [j for j in self._images if j <= k]:
            del self._images[old]


class _Earlier:
    """Frames before the start: kept ones from memory, older ones read again."""

    def __init__(self, clip: Clip, past: list[Frame], past_start: int) -> None:
        self._clip, self._past, self._start = clip, past, past_start

    def image(self, k: int) -> Image:
        if 0 <= k - self._start < len(self._past):
            return _grey(self._past[k - self._start])
        return _grey(self._clip.frame(k))


class _Reporter:
    """Counts frames for whoever wants to know."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def over(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        for frame in frames:
            yield frame
            self.at_least(self._done + 1)

    def at_least(self, done: int) -> None:
        self._done = max(self._done, done)
        if self._progress is not None:
            self._progress(min(self._done, self._total), self._total)
