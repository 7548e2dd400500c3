"""Estimates the readout of a rolling shutter from the pictures: the time from the first row's exposure to the last row's.

While the rows of a die are exposed one after the other it falls and turns, so its picture is sheared: at 3 ms from the first row
to the last, a die over a ninth of the height turns by more than a degree between its own top and bottom. The pose of a frame
cannot follow that. Each of some frames is refined with several trial readouts, its velocities being those of its flight, and
the one that leaves the least noise along its edges is that frame's estimate. The median over the frames is the clip's, with a
standard error from their scatter. Errors of the edge model differ from frame to frame as the die turns; they widen the error.

The times of the frames themselves say little: a fall through a rolling picture looks like one at another rate and spin, to first
order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.throw import State, Throw
from ..footage import Clip
from ..picture import NORMAL_MAD, View, flight_from
from ..pose import pose_state, refine_pose
from ..track import Track

Array = NDArray[np.float64]

TRIAL_SHARES = np.linspace(-1.0, 1.0, 9)
"""Trial readouts, as shares of the frame interval: no camera reads its rows more slowly."""
READOUT_FRAMES = 60
"""Most frames that are refined with every trial."""
LEAST_FRAMES = 12
"""Fewest frames with an estimate of their own whose scatter says something."""
MEDIAN_EFFICIENCY = 1.2533
"""Standard error of a median over that of a mean, of normal errors."""


@dataclass(frozen=True)
class Readout:
    """The readout that the pictures show."""

    readout_s: float
    """Time from the first row's mid-exposure to the last row's; negative if rows are read from the bottom up."""
    sigma_s: float
    frames: int
    """Number of frames that it was estimated on."""
    interval_s: float
    """Between two frames."""


def estimate_readout(
    clip: Clip, track: Track, throw: Throw, view: View, view_with: Callable[[float], View]
) -> Readout | None:
    """The readout of the camera of a clip; None if too few frames in flight show it.

    `view` is the view with which the clip was tracked, and `view_with` the same with another readout [s]."""
    rows = _frames_in_flight(track, throw)
    interval_s = float(np.median(np.diff(clip.times_s))) if len(clip) > 1 else 0.0
    if len(rows) < LEAST_FRAMES:
        return None
    trials_s = interval_s * TRIAL_SHARES
    noise = np.empty((len(rows), len(trials_s)))
    starts = [_exposed_state(track, throw, view, int(k)) for k in rows]
    pictures = [np.ascontiguousarray(clip.frame(int(k)), np.float32) for k in rows]
    for column, trial_s in enumerate(trials_s):
        trial_view = view_with(float(trial_s))
        for row, (picture, state) in enumerate(zip(pictures, starts, strict=True)):
            start = pose_state(state.position_m, state.rotation, state.velocity_m_s, state.omega_rad_s)
            noise[row, column] = refine_pose(trial_view, picture, start, coarse=0).log_noise
    estimates = np.array([_least(trials_s, each) for each in noise if np.isfinite(each).all()])
    estimates = estimates[np.isfinite(estimates)]
    if len(estimates) < LEAST_FRAMES:
        return None
    middle = float(np.median(estimates))
    scatter = NORMAL_MAD * float(np.median(np.abs(estimates - middle)))
    sigma_s = MEDIAN_EFFICIENCY * scatter / np.sqrt(len(estimates))
    return Readout(middle, sigma_s, len(estimates), interval_s)


def _frames_in_flight(track: Track, throw: Throw) -> NDArray[np.int64]:
    """Rows of at most READOUT_FRAMES tracked frames, evenly spread over the flights."""
    rows = np.flatnonzero(track.tracked)
    known = np.array([flight.covariance is not None for flight in throw.flights])
    rows = rows[known[throw.flights_at(track.time_s[rows])]]
    if not len(rows):
        return rows
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(READOUT_FRAMES, len(rows))).astype(int))]


def _exposed_state(track: Track, throw: Throw, view: View, row: int) -> State:
    """The state of the die when the row of its centre was exposed, by the readout of the view."""
    time_s, position_m = float(track.time_s[row]), track.position_m[row]
    motion = throw.at(time_s)
    state = State(time_s, position_m, track.quaternion[row], motion.velocity_m_s, motion.omega_rad_s)
    late_s = float(view.exposure_delay_s(position_m[None])[0])
    return replace(flight_from(view, state).at(time_s + late_s), time_s=time_s)


def _least(trials: Array, values: Array) -> float:
    """Where a parabola through the least of some values and its neighbours is least, within the trials; NaN without one."""
    best = int(np.clip(np.argmin(values), 1, len(values) - 2))
    a, b, _ = np.polyfit(trials[best - 1 : best + 2] / trials[-1], values[best - 1 : best + 2], 2)
    return float(np.clip(-0.5 * b / a * trials[-1], trials[0], trials[-1])) if a > 0 else np.nan
