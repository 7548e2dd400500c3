"""The contacts of a throw one after the other: each flight is followed until frames leave it, and the impact there is found.

Once a flight is known, an impact at a vertex of the die adds three numbers, its impulse, where a new flight has twelve: two
frames behind it show where it leads. So flights of a few frames are found that no segmentation of the track can see, and each
leads to the next.

From the first flight on: the motion is extended, and fitted again, until two of three frames lie off it, beyond the errors of
both. There impacts are tried at each low vertex, and free jumps, from several guesses of the velocities behind; what explains
the next frames best is taken, if it explains them better than no impact does. Where nothing does, as between contacts that follow
each other faster, the link is open, and the motion is resumed with the next flight of the segmentation.

Frames count with white errors here, as large as they are about motions through a few frames each. Errors that are correlated for
longer look like impacts then; those links are removed later, under the error model of the whole (`contacts`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.throw import Flight, State
from ..flights import (
    ErrorModel,
    FlightChain,
    Link,
    VertexImpact,
    WeightedPoses,
    chain_residuals,
    fit_flight,
    fit_states,
    flight_residuals,
    pose_jacobian,
)
from .contacts import LEAST_GAIN, Priors, can_be_impact, low_impacts, normal_velocity, usual_spacing_s
from .flight_segmentation import MIN_FRAMES, SHORTEST_WINDOW_S, contact_reach_m
from .rest import lowest_heights_m

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

WINDOW = 7
"""Frames through which one motion is laid to see the size of white errors."""
WINDOW_DOF = WINDOW - 2
"""Degrees of freedom of each of the six series in a window: a motion follows a value and a rate of each."""
MEDIAN_CHI2_SHARE = 0.87
"""Median of chi-square over its WINDOW_DOF degrees of freedom."""
LEAST_SCALE = 0.05
"""Least size of white errors, in stated sigmas."""
OFF_SIGMAS = 4.0
"""Distance of a frame from the predicted motion (rms of six numbers, in standard errors of both) at which it lies off it."""
OFF_AMONG = 3
"""Frames of which two must lie off."""
FRAMES_BEHIND = 4
"""Frames behind a contact on which impacts are compared."""
FRAMES_BEFORE = 4
"""Frames before the first that lies off a flight among which its end is looked for: a weak impact shows late."""
MOST_TOUCHES = 2
"""Instants there at which the lowest point comes to the table, and at which it is lowest, that are tried: the last of each."""
TRIAL_RESTITUTIONS = (0.2, 0.6, 0.9)
"""Restitutions of smooth impacts from which the velocities behind are guessed."""
TRIAL_FRAMES = (3, 6)
"""Frames behind whose own motion is another guess."""
TRIED = 2
"""Guesses with which an impact is fitted, those nearest to the frames behind."""
FAR_SIGMAS = 30.0
"""Distance [rms of six numbers] from which a frame counts as equally far."""
TOUCH_SAMPLES = 97
"""Instants at which the height of the die is evaluated to find where it touches."""
LEAST_GAIN_OF_JUMP = 60.0
"""Squared sigmas that free jumps of velocity and spin, as of two vertices that strike nearly at once, must explain of the next
frames: they have seven free numbers, where an impact at a vertex has three (LEAST_GAIN)."""
KNOWN_WEIGHT = 0.1
"""Weight (Tukey's biweight) above which a frame counts as lying on its flight."""
RESUMED_FRAMES = 6
"""Fewest frames of a flight with which the motion is resumed behind an open link."""
HEIGHT_SIGMAS = 3.0
"""Standard deviations of the height of a flight within which the table may be."""
SHORTEST_FLIGHT_FRAMES = 0.05
"""Least time between two contacts, in frames."""


@dataclass(frozen=True, eq=False)
class ContactSearch:
    """The frames in which contacts are looked for, and what is known of them."""

    observations: WeightedPoses
    die: Die
    impacts: Sequence[VertexImpact]
    """At each vertex."""
    parts: Sequence[Rows]
    """Rows of the flights of a segmentation."""
    errors: ErrorModel
    priors: Priors

    def fit(self, starts: Sequence[State], links: Sequence[Link], rows: slice) -> FlightChain:
        """A chain fitted to some frames."""
        return self.priors.fit(self.observations.rows(rows), starts, links, self.errors)


def follow_contacts(search: ContactSearch) -> FlightChain:
    """The chain of flights through all frames, contact by contact from the first of the flights of the segmentation."""
    first = search.parts[0]
    sequence = _Sequence(search, [fit_flight(search.observations.rows(first))[0]], [], 0, int(first[-1]) + 1)
    count = len(search.observations)
    while sequence.end < count:
        sequence = sequence.extended()
        if sequence.end < count:
            sequence = sequence.beyond_contact()
    return search.fit(sequence.starts, sequence.links, slice(0, count))


def white_errors(observations: WeightedPoses) -> ErrorModel:
    """White errors as large as the frames' about motions through WINDOW of them, or as many as last SHORTEST_WINDOW_S: the median
    over the track, of which contacts spoil some windows."""
    count = len(observations)
    step = max(1, ceil(SHORTEST_WINDOW_S / WINDOW / float(np.median(np.diff(observations.time_s)))))
    begins = np.arange(0, count - (WINDOW - 1) * step)
    if not len(begins):
        return ErrorModel.white()
    rows = [begin + step * np.arange(WINDOW) for begin in begins]
    frames = replace(observations, bias_jacobian=observations.bias_jacobian[:, :, :0])
    states, _, _ = fit_states(frames, rows)
    cuts = np.arange(0, WINDOW * len(rows) + 1, WINDOW)
    residuals = chain_residuals(frames.rows(np.concatenate(rows)), cuts, states, np.zeros(0))
    squares = (residuals.reshape(len(rows), WINDOW, 6) ** 2).sum(axis=1) / WINDOW_DOF
    scale = np.sqrt(np.median(squares, axis=0) / MEDIAN_CHI2_SHARE)
    return ErrorModel(np.maximum(scale, LEAST_SCALE), np.zeros(6), np.ones(6))


@dataclass(frozen=True, eq=False)
class _Sequence:
    """Flights and contacts up to some frame."""

    search: ContactSearch
    starts: list[State]
    links: list[Link]
    settled: int
    """Flights that are not fitted any more: all but the last two."""
    end: int
    """Row behind the last that belongs to it."""
    height_sigma_m: float = np.inf
    """Standard deviation [m] of the height of the die there; infinite until it was fitted."""

    def fitted(self, starts: Sequence[State], links: Sequence[Link], end: int) -> FlightChain:
        """The last flights fitted to the frames before a row, with others behind them if given."""
        return self.search.fit(starts[self.settled :], links[self.settled :], slice(self._first_row, end))

    @property
    def _first_row(self) -> int:
        """Of the flights that are fitted."""
        return self._row_of(self.links[self.settled - 1]) if self.settled else 0

    def _row_of(self, link: Link) -> int:
        return int(np.searchsorted(self.search.observations.time_s, link.time_s, side="right"))

    def with_fit(self, chain: FlightChain, end: int) -> _Sequence:
        """The flights as fitted, up to a row."""
        starts = [*self.starts[: self.settled], *(flight.start for flight in chain.flights)]
        links = [*self.links[: self.settled], *chain.links]
        last = self.search.observations.rows(slice(end - 1, end))
        bias = float(np.linalg.norm(last.bias_jacobian[0, 2] * self.search.priors.shared_sigma))
        slope = pose_jacobian(chain.flights[-1], last.time_s)[0, 2]
        height_sigma_m = float(np.hypot(bias, np.sqrt(max(slope @ chain.flights[-1].covariance @ slope, 0.0))))
        settled = max(len(starts) - 2, 0)
        # A contact may have moved behind all frames: the flights before it are then fitted on.
        while settled and self._row_of(links[settled - 1]) >= end:
            settled -= 1
        return _Sequence(self.search, starts, links, settled, end, height_sigma_m)

    def extended(self) -> _Sequence:
        """The last flight over the frames that lie on it, fitted again as it grows."""
        sequence, count = self, len(self.search.observations)
        while sequence.end < count:
            chain = sequence.fitted(sequence.starts, sequence.links, sequence.end)
            begin = sequence._row_of(sequence.links[-1]) if sequence.links else 0
            until = sequence.end + max(2, sequence.end - begin)
            off = _first_off(self.search, chain.flights[-1], sequence.end, min(until, count))
            grown = sequence.with_fit(chain, off)
            if off < min(until, count):
                return grown
            sequence = grown
        return sequence

    def beyond_contact(self) -> _Sequence:
        """The sequence behind what follows its last frame: an impact, no impact, or contacts that are not resolved."""
        search = self.search
        until = min(self.end + FRAMES_BEHIND, len(search.observations))
        trials = [(0.0, self.fitted(self.starts, self.links, until))]
        impacts = [*self._impacts()]
        if not impacts:
            # Nothing is there that could have been struck.
            return self.with_fit(trials[0][1], until)
        for start, link in impacts:
            chain = self.fitted([*self.starts, start], [*self.links, link], until)
            if link.impact is not None:
                trials.append((LEAST_GAIN, chain))
            elif can_be_impact(search.observations, chain, len(chain.links) - 1, search.die):
                trials.append((LEAST_GAIN_OF_JUMP, chain))
        least_gain, best = min(trials, key=lambda trial: trial[1].cost + trial[0])
        behind = best.weights[self.end - until :]
        if least_gain > 0.0:
            behind = best.weights[best.parts(search.observations.time_s[self._first_row : until])[-1]]
        if (behind > KNOWN_WEIGHT).sum() >= min(2, len(behind)):
            return self.with_fit(best, until)
        return self._resumed()

    def _resumed(self) -> _Sequence:
        """The sequence with an open link to the next flight of the segmentation; without one, some frames further on."""
        times = self.search.observations.time_s
        ahead = [part for part in self.search.parts if part[0] >= self.end - 1 and len(part) >= RESUMED_FRAMES]
        if not ahead:
            return replace(self, end=min(self.end + FRAMES_BEHIND, len(times)))
        rows = ahead[0]
        link = Link(0.5 * float(times[self.end - 1] + times[rows[0]]), is_open=True)
        start, _, _ = fit_flight(self.search.observations.rows(rows))
        end = int(rows[-1]) + 1
        return self.with_fit(self.fitted([*self.starts, start], [*self.links, link], end), end)

    def _impacts(self) -> Iterator[tuple[State, Link]]:
        """Impacts that may end the last flight: the state behind each, and the link."""
        search, flight = self.search, self.search.observations.flight(self.starts[-1])
        for instant in self._instants(flight):
            state = flight.at(instant)
            for impact in low_impacts(search.impacts, state.rotation):
                for start in self._likeliest([*self._rebounds(state, impact), *self._own_motions(state)]):
                    yield start, Link(state.time_s, impact=impact)
            for start in self._likeliest([*self._own_motions(state)]):
                yield start, Link(state.time_s)

    def _instants(self, flight: Flight) -> list[float]:
        """Instants at which an impact may end the last flight: between the last frame on it and the first off it, and where its
        lowest point came down to the table before; none if that never came near."""
        times, spacing_s = self.search.observations.time_s, usual_spacing_s(self.search.observations)
        end_s = float(times[self.end])
        begin_s = float(times[max(self.end - FRAMES_BEFORE, 0)])
        if self.links:
            begin_s = max(begin_s, self.links[-1].time_s + SHORTEST_FLIGHT_FRAMES * spacing_s)
        around = np.linspace(begin_s, max(end_s, begin_s), TOUCH_SAMPLES)
        heights = lowest_heights_m(self.search.die, *flight.poses(around))
        if heights.min() > contact_reach_m(self.search.die) + HEIGHT_SIGMAS * self.height_sigma_m:
            return []
        lowest = np.flatnonzero((np.diff(heights[:-1]) < 0.0) & (np.diff(heights[1:]) >= 0.0)) + 1
        touches = [
            *lowest[-MOST_TOUCHES:],
            *np.flatnonzero((heights[:-1] >= 0.0) & (heights[1:] < 0.0))[-MOST_TOUCHES:],
        ]
        return [*around[touches].tolist(), max(end_s - 0.5 * spacing_s, begin_s)]

    def _likeliest(self, starts: list[State]) -> list[State]:
        """TRIED of some motions behind a contact, those nearest to the next frames."""
        until = min(self.end + FRAMES_BEHIND, len(self.search.observations))
        frames = self.search.observations.rows(slice(self.end, until))

        def distance(start: State) -> float:
            squares = (flight_residuals(frames, start) ** 2 / self.search.errors.variance).mean(axis=1)
            return float(np.minimum(squares, FAR_SIGMAS**2).sum())

        return sorted(starts, key=distance)[:TRIED]

    @staticmethod
    def _rebounds(before: State, impact: VertexImpact) -> Iterator[State]:
        """States behind smooth impacts."""
        arm = impact.arm(before.rotation)
        normal = normal_velocity(before, arm)
        spin = impact.spin_change(before.rotation, np.array([0.0, 0.0, 1.0]))
        if normal < 0.0:
            for chi in TRIAL_RESTITUTIONS:
                impulse = -(1.0 + chi) * normal / (1.0 + float(np.cross(spin, arm)[2]))
                yield replace(
                    before,
                    velocity_m_s=before.velocity_m_s + np.array([0.0, 0.0, impulse]),
                    omega_rad_s=before.omega_rad_s + impulse * spin,
                )

    def _own_motions(self, before: State) -> Iterator[State]:
        """The state with velocities of the next frames by themselves."""
        observations = self.search.observations
        for count in TRIAL_FRAMES:
            rows = np.arange(self.end, min(self.end + count, len(observations)))
            if len(rows) >= MIN_FRAMES:
                state = observations.flight(fit_flight(observations.rows(rows))[0]).at(before.time_s)
                yield replace(before, velocity_m_s=state.velocity_m_s, omega_rad_s=state.omega_rad_s)


def _first_off(search: ContactSearch, flight: Flight, begin: int, end: int) -> int:
    """The first row from `begin` on at which two of OFF_AMONG frames lie off a flight; `end` if there is none."""
    count = len(search.observations)
    frames = search.observations.rows(slice(begin, min(end + OFF_AMONG - 1, count)))
    known = flight.covariance
    if known is None or not np.isfinite(known).all():
        return end
    # In standard errors of the frames. By eigenvalues, none of which is below one: a flight of few frames may know nothing of
    # some numbers, whose variance overflows what a solver can hold.
    residuals = flight_residuals(frames, flight.start) / search.errors.scale
    slope = frames.whitener @ pose_jacobian(flight, frames.time_s) / search.errors.scale[:, None]
    values, vectors = np.linalg.eigh(np.eye(6) + slope @ known @ np.swapaxes(slope, 1, 2))
    along = np.einsum("nij,ni->nj", vectors, residuals)
    off = (along**2 / np.maximum(values, 1.0)).mean(axis=1) > OFF_SIGMAS**2
    for k in range(end - begin):
        near = off[k : k + OFF_AMONG]
        if near[0] and near.sum() >= min(2, len(near)):
            return begin + k
    return end
