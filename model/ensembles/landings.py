"""Many throws at once: how releases are drawn, how they end, and the odds of the faces.

**Reproducible.** Throw number k of a seed is the same throw whatever the number of threads, the size of the chunks or
the number of throws: random numbers are drawn in blocks of 4096 throws, block b with a Philox generator of its own
(Salmon et al., SC11, 2011) seeded by (seed, b). What is gathered are whole numbers, whose sum has no order. So a tally
that was stopped can be taken up again, and memory does not grow with the number of throws.

**What is counted.** The face on which a throw is decided (`simulate`), or how else it ended: tops that spin for ever
and dice left bouncing are tallied apart. And the face that is lowest at the instant of the k-th impact, or at the end
of a throw of fewer impacts: Kapitaniak et al. (Chaos 22, 047504, 2012) report odds after a stated number of bounces.

**Intervals.** Of a count k of n throws, Wilson's (J. Am. Stat. Assoc. 22, 209, 1927): the shares p whose standard
error √(p (1 - p)/n) reaches k/n. It stays within 0 to 1 and covers what it should for few counts, too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from math import cos, inf
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import engine, throw
from ..compiled import compiled, inner
from ..die import Die
from ..engine import asymmetric
from ..laws import LEVEL, ImpactLaw, Table
from ..rotations import quat_multiply
from ..throw import BOUNCING_CAP, ENDINGS, EXACT, IMPACT_CAP, Ending, Precision, body_of, kernel_states
from .releases import BLOCK, Array, Conditions

Indices = NDArray[np.int64]
T = TypeVar("T")

ENDING_OF_INDEX = tuple(Ending)
"""Endings are stored as indices into this."""

_OF_CODE = np.full(16, -1)
_OF_CODE[list(ENDINGS)] = [ENDING_OF_INDEX.index(ending) for ending in ENDINGS.values()]
_RESTED, _BOUNCING = ENDING_OF_INDEX.index(Ending.RESTED), ENDING_OF_INDEX.index(Ending.BOUNCING)


@dataclass(frozen=True, eq=False)
class Landings:
    """How throws ended, in the order of their releases."""

    face: Indices
    """(n,) number of the face that each landed on; 0 for none."""
    impacts: Indices
    """(n,)"""
    ending: Indices
    """(n,) index into ENDING_OF_INDEX; -1 for a release below the table, which no die can have."""
    lowest: Indices
    """(n, 1 + after) number of the lowest face at release, and at the first, second, ... impact."""


@dataclass(frozen=True)
class ThrowSetup:
    """What all throws of an ensemble have in common."""

    die: Die
    law: ImpactLaw
    table: Table = LEVEL
    precision: Precision = EXACT

    @property
    def endless(self) -> bool:
        """Whether a throw may bounce for ever: then it is left after BOUNCING_CAP impacts."""
        return bool(self.law.parameters[0] >= 1.0 or self.table.moves)

    def throw(self, states: Array, after: int = 0) -> Landings:
        """Throw from each of `states` (n, 13), in world axes, at time 0, until the face is decided.

        `after` is the number of impacts at which the lowest face is noted. The compiled part lets other threads run.
        """
        n = len(states)
        landed, lowest = np.zeros((n, 3), np.int64), np.zeros((n, after + 1), np.int64)
        law = engine.law_of(self.law.code, self.law.parameters)
        precision = engine.Precision(
            self.precision.contact_tolerance_m, self.precision.slowest_bounce, self.precision.step_turn_rad
        )
        cap = BOUNCING_CAP if self.endless else IMPACT_CAP
        starts = kernel_states(self.die, self.table, states)
        # Of a loaded die under the smooth impact `tops` can prove more: that it spins on for ever.
        plain = self.law.code == engine.SMOOTH
        if self.die.is_spherical_top or (not plain and self.die.isotropic_inertia_kg_m2 is not None):
            body = body_of(self.die)
            _follow_many(body, law, self.table.plane, precision, starts, cap, landed, lowest)
        else:
            if self.law.code != engine.SMOOTH:
                raise ValueError(
                    f"{type(self.law).__name__} on a {self.die.solid.name} that is no spherical top: wanted SmoothImpact, "
                    "or a die with one moment of inertia"
                )
            top, turn = throw.asymmetric_body_of(self.die)
            starts[:, 3:7] = quat_multiply(starts[:, 3:7], turn)
            _follow_tops(top, law, self.table.plane, precision, starts, cap, landed, lowest)
        endings = np.where(landed[:, 2] < 0, -1, _OF_CODE[landed[:, 2]])
        if self.endless:
            endings[landed[:, 2] == engine.IMPACT_CAP] = _BOUNCING
        return Landings(landed[:, 0] + 1, landed[:, 1], endings, lowest + 1)


def drawn_states(conditions: Conditions, die: Die, seed: int, first: int, end: int) -> Array:
    """Releases (end - first, 13) number `first` to `end` - 1 of a seed: the same however they are asked for."""
    parts = []
    for block in range(first // BLOCK, -(-end // BLOCK)):
        random = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(block,))))
        states = conditions.states(die, BLOCK, random)
        parts.append(states[max(first - block * BLOCK, 0) : end - block * BLOCK])
    return np.concatenate(parts) if parts else np.empty((0, 13))


def chunks_in_order(
    work: Callable[[int, int], T],
    first: int,
    end: int,
    chunk: int,
    threads: int,
    executor: Executor | None = None,
) -> Iterator[tuple[int, int, T]]:
    """`work(i, j)` for the chunks of first to end, on several threads; yields (i, j, result) in order.

    An `executor` takes the place of the threads, of which `threads` then says how many calls it works on at a time; where
    its workers are other processes, `work` must be something that can be pickled.

    At most a few chunks are ahead of the one that is yielded, so that memory stays as it is. Whatever stops the caller
    drops the chunks that are not begun and waits for those that are.
    """
    pool = ThreadPoolExecutor(threads) if executor is None else executor
    ahead: deque[tuple[int, int, Future[T]]] = deque()
    try:
        for i in range(first, end, chunk):
            ahead.append((i, min(i + chunk, end), pool.submit(work, i, min(i + chunk, end))))
            if len(ahead) > 2 * threads:
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


def check_releases(stage: ThrowSetup, conditions: Conditions) -> None:
    """Raises ValueError for conditions that could release the die below the table."""
    lowest_m = conditions.lowest_m(stage.die)
    height = lowest_m * cos(stage.table.tilt_rad) - (stage.table.amplitude_m if stage.table.moves else 0.0)
    radius = stage.die.solid.circumradius
    if not height >= radius:
        raise ValueError(
            f"releases from a height of {lowest_m:.6g} m: the die reaches {radius:.6g} m from its centre, so that it could "
            "begin below the table; wanted a higher lowest release"
        )


@inner
def _note_lowest(normals: Array, log: Array, end: Array, lowest: Indices) -> None:
    """Rows of the lowest faces (after,) at the logged impacts, and at the end where there are fewer."""
    known = 0
    for event in range(log.shape[0]):
        if log[event, 1] >= 0.0 and known < lowest.shape[0]:
            lowest[known] = engine.lowest_face_row(normals, log[event, 2:15])
            known += 1
    for k in range(known, lowest.shape[0]):
        lowest[k] = engine.lowest_face_row(normals, end)


@compiled(nogil=True)
def _follow_many(
    body: engine.Body,
    law: engine.Law,
    plane: engine.Plane,
    precision: engine.Precision,
    starts: Array,
    impact_cap: int,
    landed: Indices,
    lowest: Indices,
) -> None:
    """Throw from every row of `starts` (n, 13); fills `landed` (n, 3) with face row or -1, impacts and code of the
    ending (-1: below the table), and `lowest` (n, 1 + after) with rows of faces."""
    z_table, after = engine.table_height(plane, 0.0), lowest.shape[1] - 1
    for k in range(starts.shape[0]):
        lowest[k, 0] = engine.lowest_face_row(body.normals, starts[k])
        deep = inf
        for i in range(body.vertices.shape[0]):
            deep = min(deep, engine.clearance(body.vertices[i], starts[k], z_table))
        if deep < -1e-9 * body.radius:
            landed[k, 0], landed[k, 1], landed[k, 2] = -1, 0, -1
            continue
        code, impacts, face, _, _, _, _ = engine.run_throw(
            body, law, plane, precision, starts[k], 0.0, inf, engine.NO_LIMIT, engine.TRUE, impact_cap, engine.FALSE
        )
        landed[k, 0], landed[k, 1], landed[k, 2] = face, impacts, code
        if after > 0:
            _, _, _, _, end, log, _ = engine.run_throw(
                body, law, plane, precision, starts[k], 0.0, inf, after, engine.TRUE, impact_cap, engine.TRUE
            )
            _note_lowest(body.normals, log, end, lowest[k, 1:])


@compiled(nogil=True)
def _follow_tops(
    top: engine.AsymmetricBody,
    law: engine.Law,
    plane: engine.Plane,
    precision: engine.Precision,
    starts: Array,
    impact_cap: int,
    landed: Indices,
    lowest: Indices,
) -> None:
    """As `_follow_many`, for dice that are no spherical tops; states of the centre of mass, principal axes."""
    z_table, after = engine.table_height(plane, 0.0), lowest.shape[1] - 1
    for k in range(starts.shape[0]):
        lowest[k, 0] = engine.lowest_face_row(top.normals, starts[k])
        deep = inf
        for i in range(top.vertices.shape[0]):
            deep = min(deep, engine.clearance(top.vertices[i], starts[k], z_table))
        if deep < -1e-9 * top.radius:
            landed[k, 0], landed[k, 1], landed[k, 2] = -1, 0, -1
            continue
        code, impacts, face, _, _, _, _ = asymmetric.run_asymmetric_throw(
            top, law, plane, precision, starts[k], 0.0, inf, engine.NO_LIMIT, engine.TRUE, impact_cap, engine.FALSE
        )
        landed[k, 0], landed[k, 1], landed[k, 2] = face, impacts, code
        if after > 0:
            _, _, _, _, end, log, _ = asymmetric.run_asymmetric_throw(
                top, law, plane, precision, starts[k], 0.0, inf, after, engine.TRUE, impact_cap, engine.TRUE
            )
            _note_lowest(top.normals, log, end, lowest[k, 1:])
