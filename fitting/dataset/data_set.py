"""A crowd of throws: what each of them misses by when one physics foretells all.

A frame's miss is six lengths: how far the centre is off, and the turn times the radius of gyration √(J/m), so that their
norm d is the root mean square by which the die's mass points are off. Its cost is √(d² + s²) - s, where the slack s [m]
holds what the frame's own error and the errors of the start, grown from bounce to bounce, leave open.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import rotation_between
from ...model.throw import State
from ...tracking.track import Track
from ..free import moved_state
from ..predict import FEWEST, Outset, first_bounce_row, flight_length, outset_before, simulated_throws, usable_rows
from ..throw import Physics

Array = NDArray[np.float64]

_START_DRAWS = 4
"""Starts drawn for every throw: the mean square of four is known to a half, and slack needs no more."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One throw of a joint fit."""

    name: str
    track: Track
    rows: NDArray[np.int64]
    """Rows with a pose after the first bounce."""
    early: int
    """How many of them lie before the second bounce."""
    outset: Outset

    @property
    def times_s(self) -> Array:
        """Of `rows`."""
        return self.track.time_s[self.rows]


def entry_of(name: str, track: Track, die: Die) -> Entry:
    """A throw as a joint fit wants it. Raises ValueError, with the name, where its track does not allow it."""
    try:
        row = first_bounce_row(track, die)
        rows = usable_rows(track, die)
        outset = outset_before(track, die, row)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
    after = rows[rows >= row]
    early = flight_length(track, die, after) if len(after) >= FEWEST else len(after)
    return Entry(name, track, after, early, outset)


@dataclass(frozen=True, eq=False)
class Crowd:
    """Throws, and what is the same for every trial of parameters."""

    entries: tuple[Entry, ...]
    die: Die
    pool: ThreadPoolExecutor
    slack: tuple[Array, ...]
    """(n,) [m] of each throw: s of its frames."""

    @property
    def arm_m(self) -> float:
        """The radius of gyration by which a turn counts."""
        return float(np.sqrt(self.die.inertia_kg_m2 / self.die.mass_kg))

    def misses(self, physics: Physics, strays: Sequence[Array] | None = None) -> list[Array]:
        """(n, 6) [m] of every throw: seen less simulated. From the states of the outsets, or from those displaced by
        `strays` (12,) of each throw."""
        return _misses(self.entries, physics, strays, self.arm_m, self.pool)

    def misses_of_each(self, physics: Sequence[Physics]) -> list[Array]:
        """The same with a physics for each throw; throws that share one are simulated together."""
        found: list[Array] = [np.empty((0, 6))] * len(self.entries)
        for one in {id(p): p for p in physics}.values():
            mine = [k for k, p in enumerate(physics) if p is one]
            together = _misses([self.entries[k] for k in mine], one, None, self.arm_m, self.pool)
            for k, part in zip(mine, together, strict=True):
                found[k] = part
        return found

    def costs(self, misses: Sequence[Array]) -> Array:
        """(throws,) [m]: the mean over the frames of each."""
        return np.array([_cost(miss, slack) for miss, slack in zip(misses, self.slack, strict=True)])

    def mean_cost(self, physics: Physics) -> float:
        """Over all throws [m]."""
        return float(self.costs(self.misses(physics)).mean())

    def some(self, count: int) -> Crowd:
        """At most so many of them, evenly spread."""
        which = spread(len(self.entries), count)
        return replace(self, entries=tuple(self.entries[k] for k in which), slack=tuple(self.slack[k] for k in which))


def crowd_of(entries: Sequence[Entry], physics: Physics, pool: ThreadPoolExecutor) -> Crowd:
    """The throws, each frame with its slack as this physics has the errors of the start grow."""
    bare = Crowd(tuple(entries), physics.die, pool, ())
    plain = bare.misses(physics)
    squares = [np.zeros(len(entry.rows)) for entry in entries]
    for strays in drawn_strays(entries):
        for k, strayed in enumerate(bare.misses(physics, strays)):
            squares[k] += ((strayed - plain[k]) ** 2).sum(1) / _START_DRAWS
    noise = [3.0 * (e.outset.sigma_m**2 + (bare.arm_m * e.outset.sigma_rad) ** 2) for e in entries]
    return replace(bare, slack=tuple(np.sqrt(s + n) for s, n in zip(squares, noise, strict=True)))


def drawn_strays(entries: Sequence[Entry]) -> list[list[Array]]:
    """Displacements (12,) of every start that its frames allow as well, `_START_DRAWS` times."""
    rng = np.random.default_rng(0)
    draws: list[list[Array]] = [[] for _ in range(_START_DRAWS)]
    for entry in entries:
        values, axes = np.linalg.eigh(entry.outset.covariance)
        reach = axes * np.sqrt(np.clip(values, 0.0, None))
        for drawn in draws:
            drawn.append(reach @ rng.standard_normal(12))
    return draws


def spread(total: int, count: int) -> NDArray[np.int64]:
    """At most `count` of so many places, evenly spread."""
    return np.unique(np.linspace(0, total - 1, min(count, total)).round().astype(np.int64))


def _misses(
    entries: Sequence[Entry],
    physics: Physics,
    strays: Sequence[Array] | None,
    arm_m: float,
    pool: ThreadPoolExecutor,
) -> list[Array]:
    states: list[State] = [entry.outset.of_die(physics.body).state for entry in entries]
    if strays is not None:
        states = [moved_state(state, stray) for state, stray in zip(states, strays, strict=True)]
    positions, quaternions = simulated_throws(physics, states, [entry.times_s for entry in entries], pool)
    seen = np.concatenate([entry.track.position_m[entry.rows] for entry in entries])
    turned = rotation_between(quaternions, np.concatenate([entry.track.quaternion[entry.rows] for entry in entries]))
    misses = np.hstack([seen - positions, arm_m * turned])
    # A throw that bounces on without end is given up: as far off as a die can be that lies where it should.
    misses = np.where(np.isfinite(misses), misses, np.pi * arm_m)
    return np.split(misses, np.cumsum([len(entry.rows) for entry in entries])[:-1])


def _cost(misses: Array, slack: Array) -> float:
    return float(np.mean(np.sqrt((misses**2).sum(1) + slack**2) - slack))
