"""Consistent labelling: a symmetric die draws the same picture with its faces permuted.

Tracking labels each frame like the frame before. Flights determine the labelling better where tracking lost the die for some
frames, or got one wrong. Beside unresolved contacts a "flight" may be none, and its labelling means nothing: there the marks on
the faces decide, where they tell one labelling from all others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...model.die import nearest_equivalent_rotation
from ...model.rotations import angle_between, matrix_from_quat, quat_from_rotvec
from ...model.throw import Flight, Throw
from ..footage import FrameSource
from ..picture import View
from ..pose import ClipPoses, as_track, exposure_times_s, wholly_in_view
from ..surface_marks import labels_by_marks
from ..throw import OFF_FLIGHT_RAD

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

SURE_ROWS = 3
"""Rows from one pose to the next up to which the turn between them may decide."""
SURE_TURN = 0.25
"""Turn between them, in the least angle of a symmetry, below which their labels agree: with others the die would have turned by
three times as much at the least."""
MEETING_FRAMES = 4
"""Frames that lie on a flight from which its orientation beyond them may decide: three determine it."""
MEETING_MARGIN = 0.25
"""Frames beyond the last of one flight and the first of the next at which they may meet: an impact within an exposure."""
MEETING_TURN = 0.06
"""Turn between two flights where they meet, in the least angle of a symmetry, up to which they agree: four to seven degrees."""
CLEAR_RATIO = 3.0
"""Times as far apart as in the nearest labelling that flights remain in all others if that is to decide."""
MEETING_STEP_RAD = 0.03
"""Turn of both flights from one instant that is tried to the next."""
FRAMES_PER_GROUP = 40
"""Frames from which the marks are learned that one labelling shows: the noise of their mean is a sixth of one frame's."""


def with_consistent_labels(view: View, poses: ClipPoses, throw: Throw, times_s: Array) -> ClipPoses:
    """The poses with one labelling throughout.

    An instant at which two flights meet in one labelling alone decides (`_where_flights_meet`). Where there is none, contacts
    follow each other too fast for the poses between them to be certain, and each flight takes the labelling that rotates least
    from the flight before. If a flight is off its frames at the contact, consecutive frames beside the contact decide."""
    rotation, relabelling = poses.rotation.copy(), np.eye(3)
    for k, impact in enumerate(throw.impacts):
        flights = (throw.flights[k], throw.flights[k + 1])
        meeting = _where_flights_meet(view, poses, flights, times_s)
        before, after = meeting or _at_contact(view, poses, flights, impact.time_s, times_s)
        relabelling = after.T @ nearest_equivalent_rotation(after, before @ relabelling, view.symmetries)
        end = throw.impacts[k + 1].time_s if k + 1 < len(throw.impacts) else np.inf
        inside = (times_s > impact.time_s) & (times_s <= end)
        rotation[inside] = rotation[inside] @ relabelling
    return replace(poses, rotation=rotation)


def _at_contact(
    view: View, poses: ClipPoses, flights: tuple[Flight, Flight], contact_s: float, times_s: Array
) -> tuple[Array, Array]:
    """The orientations of two flights at the instant of their contact; if either is off its frame beside it, of these frames,
    where they are consecutive."""
    known = np.flatnonzero(poses.known)
    behind = int(np.searchsorted(times_s[known], contact_s, side="right"))
    beside = known[max(behind - 1, 0) : behind + 1]
    if len(beside) == 2 and beside[1] - beside[0] == 1:
        quaternions = [flight.at(float(times_s[row])).quaternion for flight, row in zip(flights, beside, strict=True)]
        if _are_off_flight(view, poses.rotation[beside], matrix_from_quat(np.array(quaternions))).any():
            return poses.rotation[beside[0]], poses.rotation[beside[1]]
    return flights[0].at(contact_s).rotation, flights[1].at(contact_s).rotation


def _where_flights_meet(
    view: View, poses: ClipPoses, flights: tuple[Flight, Flight], times_s: Array
) -> tuple[Array, Array] | None:
    """The orientations of two flights at the instant, between the last frame on the one and the first on the other or little
    farther, at which they agree in one labelling; None where they agree in none or in several, or frames do not lie on both.

    At a spin of half a symmetry's angle a frame the instant of an unresolved contact says little: that of the least turn between
    the flights at another instant is another labelling."""
    ahead, behind = (_rows_on_flight(view, poses, flight, times_s) for flight in flights)
    if not len(ahead) or not len(behind):
        return None
    margin_s = MEETING_MARGIN * float(np.median(np.diff(times_s)))
    first_s, last_s = times_s[ahead[-1]] - margin_s, times_s[behind[0]] + margin_s
    swept_rad = (last_s - first_s) * sum(float(np.linalg.norm(flight.start.omega_rad_s)) for flight in flights)
    instants_s = np.linspace(first_s, last_s, 2 + int(swept_rad / MEETING_STEP_RAD))
    before, after = (matrix_from_quat(flight.poses(instants_s)[1]) for flight in flights)
    apart_rad = angle_between(before[:, None], after[:, None] @ view.symmetries).min(0)
    least_rad = np.sort(angle_between(np.eye(3), view.symmetries))[1:].min(initial=np.inf)
    nearest, second = np.sort(apart_rad)[:2] if len(apart_rad) > 1 else (0.0, np.inf)
    if nearest > MEETING_TURN * least_rad or second < CLEAR_RATIO * max(nearest, MEETING_STEP_RAD):
        return None
    chosen = view.symmetries[int(np.argmin(apart_rad))]
    at = int(np.argmin(angle_between(before, after @ chosen)))
    return before[at], after[at]


def _rows_on_flight(view: View, poses: ClipPoses, flight: Flight, times_s: Array) -> Rows:
    """The frames within a flight that lie on it; none if most do not, or no more than determine it."""
    rows = np.flatnonzero(poses.known & (times_s >= flight.start.time_s) & (times_s <= flight.end_s))
    there = matrix_from_quat(flight.poses(times_s[rows])[1])
    on_flight = rows[~_are_off_flight(view, poses.rotation[rows], there)]
    return on_flight if len(on_flight) >= max(MEETING_FRAMES, len(rows) // 2) else rows[:0]


def with_labels_of_marks(view: View, source: FrameSource, poses: ClipPoses, throw: Throw) -> ClipPoses:
    """The poses with one labelling throughout, by the marks on the faces, where contacts are not resolved or frames have no pose;
    between these tracking labels each frame like the frame before. Returns `poses` itself if no label changed."""
    times_s = exposure_times_s(view, source, poses)
    open_s = np.array([impact.time_s for impact in throw.impacts if impact.contact == "unresolved"])
    is_lost = ~poses.interpolated().known
    segments = np.searchsorted(open_s, times_s) + np.cumsum(is_lost & ~np.append(False, is_lost[:-1]))
    track = as_track(view, source, poses, wholly_in_view(view, poses))
    rows = np.flatnonzero(track.tracked)
    if len(view.symmetries) == 1 or not len(rows):
        return poses
    groups = _groups(view, poses, times_s, rows, segments)
    chosen = [
        mine[np.unique(np.linspace(0, len(mine) - 1, min(len(mine), FRAMES_PER_GROUP)).astype(int))]
        for k in range(int(groups.max()) + 1)
        if len(mine := rows[groups[rows] == k])
    ]
    images = ((int(k), source.frame(int(k))[0]) for mine in chosen for k in mine)
    labels = np.array(labels_by_marks(view, images, track, poses.motion, groups))
    if np.allclose(labels, np.eye(3)):
        return poses
    return replace(poses, rotation=poses.rotation @ labels[groups])


def _groups(view: View, poses: ClipPoses, times_s: Array, rows: Rows, segments: Rows) -> Rows:
    """(n,) numbers of the groups of frames that one labelling holds for, from those of the segments (n,) between contacts and
    gaps. Segments are one group if the die, by its spin and by its poses, turns so little between them that no other labelling
    is possible. `rows` are those of poses that can be compared; the others go with one of their own segment."""
    rotation = poses.rotation[rows]
    spin_rad_s = np.linalg.norm(poses.motion[rows, 3:], axis=1)
    spun_rad = np.maximum(spin_rad_s[:-1], spin_rad_s[1:]) * np.diff(times_s[rows])
    turn_rad = np.maximum(angle_between(rotation[:-1], rotation[1:]), spun_rad)
    least_rad = np.sort(angle_between(np.eye(3), view.symmetries))[1:].min(initial=np.inf)
    is_sure = (np.diff(rows) <= SURE_ROWS) & (turn_rad < SURE_TURN * least_rad)
    group = np.cumsum(np.append(False, (np.diff(segments[rows]) != 0) & ~is_sure))
    behind = np.searchsorted(rows, np.arange(len(segments)))
    before, after = np.maximum(behind - 1, 0), np.minimum(behind, len(rows) - 1)
    return np.asarray(group[np.where(segments[rows[after]] == segments, after, before)])


def with_rows_of(view: View, poses: ClipPoses, others: ClipPoses, rows: Rows, times_s: Array) -> ClipPoses:
    """The poses with some rows, in ascending order, of others. The labelling of each part continues that of the frames before."""
    out = poses.copy()
    out.take(rows, others)
    for k in (int(rows[0]), int(rows[-1]) + 1):
        out = with_labels_continued(view, out, times_s, k)
    return out


def with_labels_continued(view: View, poses: ClipPoses, times_s: Array, k: int) -> ClipPoses:
    """The poses with those from row `k` on in the labelling that rotates least from the poses before, each continued with its own
    spin to midway between the two."""
    before, after = np.flatnonzero(poses.known[:k]), k + np.flatnonzero(poses.known[k:])
    if not len(before) or not len(after):
        return poses
    last, first = int(before[-1]), int(after[0])
    half_s = 0.5 * float(times_s[first] - times_s[last])
    there, here = (
        matrix_from_quat(quat_from_rotvec(step_s * poses.motion[row, 3:])) @ poses.rotation[row]
        for row, step_s in ((last, half_s), (first, -half_s))
    )
    rotation = poses.rotation.copy()
    rotation[k:] = rotation[k:] @ (here.T @ nearest_equivalent_rotation(here, there, view.symmetries))
    return replace(poses, rotation=rotation)


def with_labels_of_flights(view: View, poses: ClipPoses, flights: ClipPoses, tracked: ClipPoses) -> ClipPoses:
    """The poses in the labelling of the poses that flights give on every frame, and where these are off, in that of `tracked`
    poses."""
    rows, rotation = np.flatnonzero(poses.known), poses.rotation.copy()
    rotation[rows] = nearest_equivalent_rotation(rotation[rows], flights.rotation[rows], view.symmetries)
    off = rows[tracked.known[rows] & _are_off_flight(view, rotation[rows], flights.rotation[rows])]
    rotation[off] = nearest_equivalent_rotation(rotation[off], tracked.rotation[off], view.symmetries)
    return replace(poses, rotation=rotation)


def _are_off_flight(view: View, rotation: Array, flight: Array) -> NDArray[np.bool_]:
    """(n,) whether frames (n, 3, 3) lie further than OFF_FLIGHT_RAD from their flight (n, 3, 3) in every labelling."""
    return angle_between(nearest_equivalent_rotation(rotation, flight, view.symmetries), flight) > OFF_FLIGHT_RAD
