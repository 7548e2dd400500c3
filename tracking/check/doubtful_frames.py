"""Names the frames whose poses contradict each other or the laws that every throw obeys.

A wrong pose, such as the depth reversal of the die, agrees with its picture and states a small standard error. Other frames and
the table show that it is wrong:

- no flight explains it (`MeasuredThrow.unexplained`);
- its flight explains its frames worse than their own errors allow, beside a contact that is not resolved already if they scatter
  more than usual: such a contact may be the end of one labelling or of one way of seeing the die, and the beginning of another;
- it lies below the table, or its flight has more energy than the one before.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.throw import Flight, energy_J
from ..throw import MeasuredThrow, lowest_heights_m
from ..track import Track

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_RESIDUAL_SIGMAS = 6.0
"""Residual standard deviation of the frames of a flight, in stated standard errors, beyond which they are named. Covariances are
scaled up by it. Of 1011 flights of 310 random clips 17 lay above 6, of which 14 had wrong poses."""
MAX_SIGMAS_BESIDE_UNRESOLVED = 2.0
"""The same for a flight that an unresolved contact begins or ends. Of the frames that 90 random clips had in such flights, and no
other rule named, 63 per cent were wrong."""
MAX_DEPTH_SHARE = 0.15
"""Depth of the lowest point below the table, as a share of an edge, beyond which frames are named: half a per cent of the
distance to the camera is as much."""
MAX_ENERGY_GAIN = 0.05
"""Gain of energy at a bounce, as a share, beyond which the flights beside it are named."""
SIGMAS = 5.0
"""The same two in standard errors."""
JOINED_FRAMES = 3
"""Ranges of frames that lie no farther apart are named as one."""
DOUBT = "some of these poses are wrong, or the [camera] is"


def doubtful_frame_notices(found: MeasuredThrow, smoothed: Track) -> tuple[str, ...]:
    """A sentence for each kind of contradiction, with the frames that it is about, whose poses are those of `smoothed`."""
    residual_sigmas, below_m = found.residual_sigmas, _below_table_m(smoothed, found.die)
    lowest_mm, largest = 1e3 * below_m.max(initial=0.0), np.nanmax(residual_sigmas, initial=0.0)
    scattered = residual_sigmas > MAX_RESIDUAL_SIGMAS
    beside = _beside_unresolved(found, smoothed) & (residual_sigmas > MAX_SIGMAS_BESIDE_UNRESOLVED) & ~scattered
    most = np.max(residual_sigmas[beside], initial=0.0)
    kinds = (
        (
            found.unexplained,
            "No flight explains {}: what is said of them rests on single pictures, and no model is fitted to them.",
        ),
        (
            scattered,
            f"The poses of {{}} differ from their flight by {largest:.0f} times the errors that they state: {DOUBT}.",
        ),
        (
            beside,
            f"The poses of {{}}, beside a contact that is not resolved, differ from their flight by {most:.1f} times the errors "
            f"that they state: {DOUBT}.",
        ),
        (below_m > 0.0, f"The die is up to {lowest_mm:.1f} mm below the table on {{}}: {DOUBT}."),
        (_gaining_energy(found, smoothed), f"The die gains energy at a bounce in {{}}: {DOUBT}."),
    )
    return tuple(
        sentence.format(_ranges(smoothed.frame[doubtful & smoothed.tracked]))
        for doubtful, sentence in kinds
        if (doubtful & smoothed.tracked).any()
    )


def _ranges(frames: NDArray[np.int64]) -> str:
    """Frame numbers (n,) in words, as "frames 3 to 5 and frame 9"."""
    parts = np.split(frames, np.flatnonzero(np.diff(frames) > JOINED_FRAMES) + 1)
    texts = [f"frame {each[0]}" if len(each) == 1 else f"frames {each[0]} to {each[-1]}" for each in parts]
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def _below_table_m(track: Track, die: Die) -> Array:
    """(n,) depth [m] of the lowest point below the table; 0 where it is not clearly below."""
    below, rows = np.zeros(len(track)), np.flatnonzero(track.tracked)
    depth = -lowest_heights_m(die, track.position_m[rows], track.quaternion[rows])
    clear = np.maximum(MAX_DEPTH_SHARE * die.solid.edge_m, SIGMAS * np.sqrt(track.covariance[rows, 2, 2]))
    below[rows] = np.where(depth > clear, depth, 0.0)
    return below


def _beside_unresolved(found: MeasuredThrow, track: Track) -> Mask:
    """(n,) frames of the flights that an unresolved contact begins or ends."""
    which = found.throw.flights_at(track.time_s)
    unresolved = [k for k, impact in enumerate(found.throw.impacts) if impact.contact == "unresolved"]
    return np.isin(which, unresolved) | np.isin(which, np.add(unresolved, 1))


def _gaining_energy(found: MeasuredThrow, track: Track) -> Mask:
    """(n,) frames of the flights beside bounces at which the die gains energy."""
    out = np.zeros(len(track), bool)
    which = found.throw.flights_at(track.time_s)
    for k, (before, after) in enumerate(zip(found.throw.flights[:-1], found.throw.flights[1:], strict=True)):
        if before.covariance is None or after.covariance is None:
            continue
        (first_J, first_sigma_J), (next_J, next_sigma_J) = (_energy(found.die, flight) for flight in (before, after))
        if next_J - first_J > max(MAX_ENERGY_GAIN * first_J, SIGMAS * float(np.hypot(first_sigma_J, next_sigma_J))):
            out |= (which == k) | (which == k + 1)
    return out


def _energy(die: Die, flight: Flight) -> tuple[float, float]:
    """Energy [J] of a flight with a covariance, and its standard error, by its velocities alone."""
    v, w = flight.start.velocity_m_s, flight.start.omega_rad_s
    weight = np.array([0.0, 0.0, die.mass_kg * flight.gravity_m_s2])
    rotation = flight.start.rotation
    slope = np.concatenate([weight, np.zeros(3), die.mass_kg * v, rotation @ die.tensor_kg_m2 @ rotation.T @ w])
    return energy_J(die, flight.start, flight.gravity_m_s2), float(np.sqrt(max(slope @ flight.covariance @ slope, 0.0)))
