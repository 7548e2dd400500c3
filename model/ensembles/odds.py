"""model.ensembles.odds."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, fields
from functools import partial
from math import sqrt
from statistics import NormalDist
from typing import Any

import numpy as np

from .landings import ENDING_OF_INDEX, Indices, Landings, ThrowSetup, check_releases, chunks_in_order, drawn_states
from .releases import BLOCK, Conditions


@dataclass(frozen=True, eq=False)
class Tally:
    """Counts of an ensemble, all whole numbers; n is the number of faces of the die."""

    throws: int
    """How many throws were made: the first so many of the seed."""
    landed: Indices
    """(n,) of each face, in the order of their numbers."""
    endings: Indices
    """(endings,) in the order of ENDING_OF_INDEX."""
    lowest: Indices
    """(1 + after, n) how often each face was the lowest at release and at each impact."""
    as_start: Indices
    """(1 + after,) how often that was the face that was lowest at release."""
    as_landed: Indices
    """(1 + after,) how often it was the face that the die landed on."""
    landed_as_start: int
    """How often the die landed on the face that was lowest at release."""
    impacts: int
    """Of all throws together."""
    most_impacts: int
    """Of one throw."""

    @classmethod
    def nothing(cls, faces: int, after: int) -> Tally:
        """The tally of no throw."""
        row = np.zeros(after + 1, np.int64)
        endings, table = np.zeros(len(ENDING_OF_INDEX), np.int64), np.zeros((after + 1, faces), np.int64)
        return cls(0, table[0].copy(), endings, table, row, row.copy(), 0, 0, 0)

    @classmethod
    def of(cls, landings: Landings, faces: int) -> Tally:
        """The tally of some throws."""
        start, lowest = landings.lowest[:, :1], landings.lowest
        by_face = [np.bincount(column, minlength=faces + 1)[1:] for column in lowest.T]
        return cls(
            len(landings.face),
            np.bincount(landings.face, minlength=faces + 1)[1:],
            np.bincount(landings.ending, minlength=len(ENDING_OF_INDEX)),
            np.array(by_face),
            (lowest == start).sum(0),
            (lowest == landings.face[:, None]).sum(0),
            int((landings.face == start[:, 0]).sum()),
            int(landings.impacts.sum()),
            int(landings.impacts.max(initial=0)),
        )

    def __add__(self, other: Tally) -> Tally:
        sums: dict[str, Any] = {
            part.name: getattr(self, part.name) + getattr(other, part.name) for part in fields(self)
        }
        return Tally(**sums | {"most_impacts": max(self.most_impacts, other.most_impacts)})

    @property
    def rested(self) -> int:
        """Throws that landed on a face."""
        return int(self.landed.sum())


@dataclass(frozen=True)
class Share:
    """A count out of so many, with Wilson's interval of the probability behind it."""

    count: int
    of: int
    level: float = 0.95

    @property
    def value(self) -> float:
        """The share itself; NaN of nothing."""
        return self.count / self.of if self.of else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper bound; 0 and 1 where there was nothing."""
        return wilson_interval(self.count, self.of, self.level)


def wilson_interval(count: int, of: int, level: float = 0.95) -> tuple[float, float]:
    """Wilson's score interval (low, high) of a probability, from `count` successes `of` so many trials."""
    if not (0 <= count <= of and 0.0 < level < 1.0):
        raise ValueError(f"{count} of {of} at level {level}: wanted 0 <= count <= of, and a level between 0 and 1")
    if of == 0:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(0.5 + 0.5 * level)
    p, z2 = count / of, z * z / of
    middle, half = p + 0.5 * z2, sqrt(z2 * (p * (1.0 - p) + 0.25 * z2))
    # The exact bounds at the ends, where the subtraction would leave a rounding error.
    low = 0.0 if count == 0 else (middle - half) / (1.0 + z2)
    high = 1.0 if count == of else (middle + half) / (1.0 + z2)
    return low, high


def tally_throws(
    stage: ThrowSetup,
    conditions: Conditions,
    throws: int,
    seed: int,
    *,
    after: int = 0,
    begun: Tally | None = None,
    chunk: int = BLOCK,
    threads: int = 1,
    executor: Executor | None = None,
) -> Iterator[Tally]:
    """Throw `throws` times and yield the tally so far after every chunk; the last is the tally of all.

    `begun` is a tally of the same ensemble to go on from. `chunk`, `threads` and `executor` (see `chunks_in_order`) change the
    speed, never a count. Raises ValueError for conditions that could release the die below the table.
    """
    check_releases(stage, conditions)
    if throws < 1 or chunk < 1 or threads < 1 or after < 0:
        raise ValueError(
            f"throws = {throws}, chunk = {chunk}, threads = {threads}, after = {after}: wanted 1 or more, after 0 or more"
        )
    tally = Tally.nothing(len(stage.die.solid.faces), after) if begun is None else begun
    work = partial(tally_of, stage, conditions, seed, after)
    yield tally
    for _, _, part in chunks_in_order(work, tally.throws, throws, chunk, threads, executor):
        tally += part
        yield tally


def tally_of(stage: ThrowSetup, conditions: Conditions, seed: int, after: int, first: int, end: int) -> Tally:
    """The tally of throws number `first` to `end` - 1 of a seed alone."""
    states = drawn_states(conditions, stage.die, seed, first, end)
    return Tally.of(stage.throw(states, after), len(stage.die.solid.faces))
