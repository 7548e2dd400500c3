"""A data set of throws, and the residuals that each of them has when one physics predicts all.

A frame's residual has six lengths: the offset of the centre, and the rotation vector times the radius of gyration √(J/m).
Their norm d is the root-mean-square distance by which the die's mass points are off. Its cost is √(d² + s²) - s. The slack
s [m] covers the frame's own error and the errors of the release state, grown from bounce to bounce.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.errors import InputError
from ...model.rotations import rotation_between
from ...model.throw import packed_state
from ...tracking.covariance import covariance_root
from ...tracking.flights import perturbed
from ...tracking.track import Track
from ..predict import (
    MIN_FLIGHT_FRAMES,
    ReleaseState,
    first_bounce_row,
    flight_length,
    release_before,
    simulated_packed,
    usable_rows,
)
from ..throw import Physics

Array = NDArray[np.float64]

_RELEASE_DRAWS = 4
"""Release states drawn for every throw: the mean square of four is known to a half, and slack needs no more."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One throw of a joint fit."""

    name: str
    track: Track
    rows: NDArray[np.int64]
    """Rows with a pose after the first bounce."""
    early: int
    """How many of them lie before the second bounce."""
    release: ReleaseState

    @property
    def times_s(self) -> Array:
        """Of `rows`."""
        return self.track.time_s[self.rows]


def entry_of(name: str, track: Track, die: Die) -> Entry:
    """A throw for a joint fit. Raises ValueError, with the name, for a track that cannot be fitted."""
    try:
        row = first_bounce_row(track, die)
        rows = usable_rows(track, die)
        release = release_before(track, die, row)
    except ValueError as error:
        raise InputError(f"{name}: {error}") from error
    after = rows[rows >= row]
    early = flight_length(track, die, after) if len(after) >= MIN_FLIGHT_FRAMES else len(after)
    return Entry(name, track, after, early, release)


@dataclass(frozen=True, eq=False)
class DataSet:
    """Throws, and what is the same for every trial of parameters."""

    entries: tuple[Entry, ...]
    die: Die
    pool: ThreadPoolExecutor
    slack: tuple[Array, ...]
    """(n,) [m] of each throw: s of its frames."""

    @property
    def arm_m(self) -> float:
        """The radius of gyration, which converts rotations to lengths: of the mean moment."""
        return float(np.sqrt(np.trace(self.die.tensor_kg_m2) / (3.0 * self.die.mass_kg)))

    def residuals(self, physics: Physics, perturbations: Sequence[Array] | None = None) -> list[Array]:
        """(n, 6) [m] of every throw: observed minus simulated, from the release states or, with `perturbations` (12,) of
        each throw, from perturbed ones."""
        return _residuals(self.entries, physics, perturbations, self.arm_m, self.pool)

    def residuals_of_each(self, physics: Sequence[Physics]) -> list[Array]:
        """The same with a physics for each throw; throws that share one are simulated together."""
        found: list[Array] = [np.empty((0, 6))] * len(self.entries)
        for one in {id(p): p for p in physics}.values():
            mine = [k for k, p in enumerate(physics) if p is one]
            together = _residuals([self.entries[k] for k in mine], one, None, self.arm_m, self.pool)
            for k, part in zip(mine, together, strict=True):
                found[k] = part
        return found

    def costs(self, residuals: Sequence[Array]) -> Array:
        """(throws,) [m]: the mean over the frames of each."""
        return np.array([_cost(own, slack) for own, slack in zip(residuals, self.slack, strict=True)])

    def mean_cost(self, physics: Physics) -> float:
        """Over all throws [m]."""
        return float(self.costs(self.residuals(physics)).mean())

    def some(self, which: NDArray[np.int64]) -> DataSet:
        """Some of the throws."""
        return replace(self, entries=tuple(self.entries[k] for k in which), slack=tuple(self.slack[k] for k in which))

    def subset(self, count: int) -> DataSet:
        """At most `count` throws, evenly spread."""
        return self.some(evenly_spread(len(self.entries), count))


def data_set_of(entries: Sequence[Entry], physics: Physics, pool: ThreadPoolExecutor) -> DataSet:
    """The throws, with the slack of each frame as errors of the release state grow under this physics."""
    without_slack = DataSet(tuple(entries), physics.die, pool, ())
    plain = without_slack.residuals(physics)
    squares = [np.zeros(len(entry.rows)) for entry in entries]
    for perturbations in drawn_perturbations(entries):
        for k, moved in enumerate(without_slack.residuals(physics, perturbations)):
            squares[k] += ((moved - plain[k]) ** 2).sum(1) / _RELEASE_DRAWS
    arm_m = without_slack.arm_m
    noise = [3.0 * (e.release.sigma_m**2 + (arm_m * e.release.sigma_rad) ** 2) for e in entries]
    return replace(without_slack, slack=tuple(np.sqrt(s + n) for s, n in zip(squares, noise, strict=True)))


def drawn_perturbations(entries: Sequence[Entry]) -> list[list[Array]]:
    """Perturbations (12,) of every release state, drawn from its covariance, `_RELEASE_DRAWS` times."""
    rng = np.random.default_rng(0)
    draws: list[list[Array]] = [[] for _ in range(_RELEASE_DRAWS)]
    for entry in entries:
        root = covariance_root(entry.release.covariance)
        for drawn in draws:
            drawn.append(root @ rng.standard_normal(12))
    return draws


def evenly_spread(total: int, count: int) -> NDArray[np.int64]:
    """At most `count` of `total` indices, evenly spread."""
    return np.unique(np.linspace(0, total - 1, min(count, total)).round().astype(np.int64))


def _residuals(
    entries: Sequence[Entry],
    physics: Physics,
    perturbations: Sequence[Array] | None,
    arm_m: float,
    pool: ThreadPoolExecutor,
) -> list[Array]:
    if perturbations is None:
        centre_m = physics.body.centre_of_mass_m
        packed = _packed_releases(tuple(entries), None if centre_m is None else tuple(centre_m.tolist()))
    else:
        states = [entry.release.of_die(physics.body).state for entry in entries]
        packed = np.array([packed_state(perturbed(s, change)) for s, change in zip(states, perturbations, strict=True)])
    begins_s = np.array([entry.release.fair_state.time_s for entry in entries])
    times_s = [entry.times_s for entry in entries]
    positions, quaternions = simulated_packed(physics, packed, begins_s, times_s, pool)
    observed = np.concatenate([entry.track.position_m[entry.rows] for entry in entries])
    turned = rotation_between(quaternions, np.concatenate([entry.track.quaternion[entry.rows] for entry in entries]))
    residuals = np.hstack([observed - positions, arm_m * turned])
    # A throw that never stops bouncing has no poses: it counts as a die in the right place with the worst orientation.
    residuals = np.where(np.isfinite(residuals), residuals, np.pi * arm_m)
    return np.split(residuals, np.cumsum([len(entry.rows) for entry in entries])[:-1])


@lru_cache(maxsize=64)
def _packed_releases(entries: tuple[Entry, ...], centre_m: tuple[float, ...] | None) -> Array:
    """The release states (throws, 13) for a centre of mass, which many trials share."""
    centre = None if centre_m is None else np.array(centre_m)
    return np.array([packed_state(replace(e.release, centre_of_mass_m=centre).state) for e in entries])


def _cost(residuals: Array, slack: Array) -> float:
    return float(np.mean(np.sqrt((residuals**2).sum(1) + slack**2) - slack))
