"""The odds of the faces: counts of many throws, with intervals.

**What is counted.** The face on which each throw is decided, or how else it ended, because dice that spin for ever and
dice that were stopped while bouncing land on no face. Also the face that is lowest at the k-th impact, or at the end of
a throw of fewer impacts: Kapitaniak et al. (Chaos 22, 047504, 2012) report odds after a stated number of bounces. All
counts are whole numbers, whose sum does not depend on order. So a tally that was stopped can be continued, and memory
does not grow with the number of throws.

**Intervals.** Of a count k of n throws, Wilson's (J. Am. Stat. Assoc. 22, 209, 1927): the probabilities p from which
k/n differs by no more than a multiple of their standard error √(p (1 - p)/n). It stays within 0 to 1 and has its
nominal coverage for small counts as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, fields
from functools import partial
from math import cos, sqrt
from typing import Any

import numpy as np
from scipy.special import ndtri

from ..errors import InputError
from .landings import ENDING_OF_INDEX, Indices, Landings, ThrowSetup, chunks_in_order
from .releases import BLOCK, Conditions, drawn_states


@dataclass(frozen=True, eq=False)
class Tally:
    """Counts of an ensemble; n is the number of faces of the die."""

    throws: int
    """Number of throws made, the first ones of the seed."""
    landed: Indices
    """(n,) throws that landed on each face, in the order of the face numbers."""
    endings: Indices
    """(endings,) throws of each ending, in the order of ENDING_OF_INDEX."""
    lowest: Indices
    """(1 + after, n) throws in which each face was the lowest at release and at each impact."""
    as_start: Indices
    """(1 + after,) throws in which the lowest face was the one that was lowest at release."""
    as_landed: Indices
    """(1 + after,) throws in which the lowest face was the one on which the die landed."""
    landed_as_start: int
    """Throws that landed on the face that was lowest at release."""
    impacts: int
    """Of all throws in total."""
    most_impacts: int
    """Largest number of impacts of one throw."""

    @classmethod
    def empty(cls, faces: int, after: int) -> Tally:
        """The tally of no throws."""
        row = np.zeros(after + 1, np.int64)
        endings, table = np.zeros(len(ENDING_OF_INDEX), np.int64), np.zeros((after + 1, faces), np.int64)
        return cls(0, table[0].copy(), endings, table, row, row.copy(), 0, 0, 0)

    @classmethod
    def of(cls, landings: Landings, faces: int) -> Tally:
        """The tally of landings."""
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
    """A count of a total, with Wilson's interval of the probability."""

    count: int
    of: int
    level: float = 0.95

    @property
    def value(self) -> float:
        """The share itself; NaN for a total of 0."""
        return self.count / self.of if self.of else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper bound; 0 and 1 for a total of 0. Raises ValueError for a count that is not within the total."""
        if self.of == self.count == 0:
            return 0.0, 1.0
        if not 0 <= self.count <= self.of:
            raise ValueError(f"a count of {self.count} in a total of {self.of}: wanted 0 to {self.of}")
        # `scipy.stats.binomtest` gives the same, and takes half a second to load.
        n, p, z = self.of, self.count / self.of, float(ndtri(0.5 + 0.5 * self.level))
        centre, half = p + z * z / (2 * n), z * sqrt(p * (1.0 - p) / n + z * z / (4.0 * n * n))
        shrunk = 1.0 + z * z / n
        low = 0.0 if self.count == 0 else (centre - half) / shrunk
        high = 1.0 if self.count == n else (centre + half) / shrunk
        return low, high


def check_releases(setup: ThrowSetup, conditions: Conditions) -> None:
    """Raise ValueError for conditions that could release the die below the table."""
    lowest_m = conditions.lowest_m(setup.die)
    height = lowest_m * cos(setup.table.tilt_rad) - (setup.table.amplitude_m if setup.table.moves else 0.0)
    radius = setup.die.solid.circumradius
    if not height >= radius:
        raise InputError(
            f"releases from a height of {lowest_m:.6g} m: a vertex of the die is up to {radius:.6g} m below its centre, and "
            "could begin below the table; wanted a higher lowest release"
        )


def tally_throws(
    setup: ThrowSetup,
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

    `begun` is a tally of the same ensemble to continue. `chunk`, `threads` and `executor` (see `chunks_in_order`) change the
    speed, never a count. Raises ValueError for conditions that could release the die below the table, and for numbers below 1
    (`after`: below 0).
    """
    check_releases(setup, conditions)
    if throws < 1 or chunk < 1 or threads < 1 or after < 0:
        raise InputError(
            f"throws = {throws}, chunk = {chunk}, threads = {threads}, after = {after}: wanted 1 or more, and 0 or more for after"
        )
    tally = Tally.empty(len(setup.die.solid.faces), after) if begun is None else begun
    work = partial(tally_of, setup, conditions, seed, after)
    yield tally
    for _, _, part in chunks_in_order(work, tally.throws, throws, chunk, threads, executor):
        tally += part
        yield tally


def tally_of(setup: ThrowSetup, conditions: Conditions, seed: int, after: int, first: int, end: int) -> Tally:
    """The tally of throws number `first` to `end` - 1 of a seed."""
    states = drawn_states(conditions, setup.die, seed, first, end)
    return Tally.of(setup.throw(states, after), len(setup.die.solid.faces))
