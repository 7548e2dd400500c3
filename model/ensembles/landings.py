"""Many throws at once: how each of them ends, and which face is lowest on the way.

**Landings.** A throw is followed until its face is decided (`throw.simulate`), or until it ends otherwise: spinning on
a vertex for ever, or stopped while it bounces. The compiled loops release the interpreter's lock, so threads share the
work.

**Chunks.** `chunks_in_order` works on several chunks at a time and yields their results in order, whatever the number
of threads or the executor.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import engine
from ..die import Die
from ..laws import LEVEL, ImpactLaw, Table
from ..rotations import quat_multiply
from ..throw import (
    BOUNCING_CAP,
    ENDINGS,
    EXACT,
    IMPACT_CAP,
    Door,
    Ending,
    Precision,
    asymmetric_body_of,
    body_kind,
    body_of,
    is_endless,
    kernel_states,
    needs_asymmetric_kernels,
    refuse_unsupported,
)
from .landing_kernels import BELOW_TABLE, land_releases
from .releases import Array

Indices = NDArray[np.int64]
T = TypeVar("T")

ENDING_OF_INDEX = tuple(Ending)
"""Endings are stored as indices into this tuple."""

CHUNKS_AHEAD_PER_THREAD = 2
"""Chunks submitted ahead of the one that is yielded. Fewer leave threads idle, more hold more results in memory."""

_INDEX_OF_CODE = np.full(max(ENDINGS) + 1, -1)
_INDEX_OF_CODE[list(ENDINGS)] = [ENDING_OF_INDEX.index(ending) for ending in ENDINGS.values()]
_BOUNCING = ENDING_OF_INDEX.index(Ending.BOUNCING)


@dataclass(frozen=True, eq=False)
class Landings:
    """How throws ended, in the order of their releases."""

    face: Indices
    """(n,) number of the face on which each landed; 0 for none."""
    impacts: Indices
    """(n,) number of impacts."""
    ending: Indices
    """(n,) index into ENDING_OF_INDEX; -1 for a release below the table, which is not thrown."""
    lowest: Indices
    """(n, 1 + after) number of the lowest face at release, and at the first, second, … impact."""


@dataclass(frozen=True)
class ThrowSetup:
    """What all throws of an ensemble have in common."""

    die: Die
    law: ImpactLaw
    table: Table = LEVEL
    precision: Precision = EXACT
    drag_per_m: float = 0.0
    """k of `throw_die`."""

    @property
    def packed_law(self) -> engine.Law:
        """The law as the kernels take it."""
        return engine.law_of(self.law.code, self.law.parameters)

    @property
    def packed(self) -> engine.Setup:
        """The record that the kernels take, for a die with one moment of inertia."""
        plane = self.table.plane_in_air(self.drag_per_m)
        return engine.Setup(body_of(self.die), self.packed_law, plane, self.precision.packed)

    @property
    def impact_cap(self) -> int:
        """Impacts after which a throw is stopped, as by `throw_die`."""
        return BOUNCING_CAP if is_endless(self.law, self.table) else IMPACT_CAP

    def ending(self, code: int) -> Ending:
        """How a throw ended, from the code of the kernels."""
        return Ending.BOUNCING if code == engine.IMPACT_CAP and is_endless(self.law, self.table) else ENDINGS[code]

    def throw(self, states: Array, after: int = 0) -> Landings:
        """Throw from each of `states` (n, 13), in world axes, at time 0, until the face is decided.

        `after` is the number of impacts at which the lowest face is recorded. A throw that may never end is stopped after
        BOUNCING_CAP impacts. Raises ValueError for what `throw.supported` does not combine.
        """
        landed, lowest = np.zeros((len(states), 3), np.int64), np.zeros((len(states), after + 1), np.int64)
        starts = kernel_states(self.die, self.table, states)
        kind = body_kind(self.die)
        refuse_unsupported(Door.THROW, kind, self.packed_law, has_drag=self.drag_per_m > 0.0)
        if needs_asymmetric_kernels(kind, self.packed_law):
            body, body_from_principal = asymmetric_body_of(self.die)
            starts[:, 3:7] = quat_multiply(starts[:, 3:7], body_from_principal)
            packed = engine.Setup(body, self.packed_law, self.table.plane, self.precision.packed)
        else:
            packed = self.packed
        land_releases(packed, starts, self.impact_cap, landed, lowest)
        endings = np.where(landed[:, 2] == BELOW_TABLE, -1, _INDEX_OF_CODE[landed[:, 2]])
        if is_endless(self.law, self.table):
            endings[landed[:, 2] == engine.IMPACT_CAP] = _BOUNCING
        return Landings(landed[:, 0] + 1, landed[:, 1], endings, lowest + 1)


def chunks_in_order(
    work: Callable[[int, int], T],
    first: int,
    end: int,
    chunk: int,
    threads: int,
    executor: Executor | None = None,
) -> Iterator[tuple[int, int, T]]:
    """`work(i, j)` for the chunks of the range from `first` to `end`, on several threads; yields (i, j, result) in order.

    An `executor` replaces the threads; `threads` is then the number of calls that it works on at a time. If its workers are
    other processes, `work` must be picklable.

    At most CHUNKS_AHEAD_PER_THREAD chunks a thread are submitted ahead, so memory stays bounded. If the caller stops, chunks
    that have not begun are cancelled, and those that have begun are finished first.
    """
    pool = ThreadPoolExecutor(threads) if executor is None else executor
    ahead: deque[tuple[int, int, Future[T]]] = deque()
    try:
        for i in range(first, end, chunk):
            ahead.append((i, min(i + chunk, end), pool.submit(work, i, min(i + chunk, end))))
            if len(ahead) > CHUNKS_AHEAD_PER_THREAD * threads:
                done = ahead.popleft()
                yield done[0], done[1], done[2].result()
        while ahead:
            done = ahead.popleft()
            yield done[0], done[1], done[2].result()
    finally:
        for _, _, future in ahead:
            future.cancel()
        if executor is None:
            pool.shutdown()
