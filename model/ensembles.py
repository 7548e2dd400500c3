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
from dataclasses import dataclass, fields
from functools import partial
from math import cos, inf, sin, sqrt
from statistics import NormalDist
from typing import Any, Protocol, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from . import kernels, tops
from .bodies import body_of, kernel_starts
from .compiled import compiled
from .impacts import ImpactLaw
from .rotations import quat_multiply
from .simulate import BOUNCING_CAP, ENDINGS, EXACT, IMPACT_CAP, Ending, Precision
from .solids import Die
from .tables import LEVEL, Table

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
T = TypeVar("T")

BLOCK = 4096
"""Throws that share one generator. Part of what a seed means: another number gives other throws."""

CONDITIONS = ("z0", "psi", "theta", "phi", "vx", "vy", "vz", "omega_xi", "omega_eta", "omega_zeta")
"""The paper's initial conditions: height [m], Euler angles [rad], velocity [m/s], body-frame spin [rad/s]. The table
looks the same everywhere, so x0 and y0 are left out."""

ENDING_OF_INDEX = tuple(Ending)
"""Endings are stored as indices into this."""

_OF_CODE = np.full(16, -1)
_OF_CODE[list(ENDINGS)] = [ENDING_OF_INDEX.index(ending) for ending in ENDINGS.values()]
_RESTED, _BOUNCING = ENDING_OF_INDEX.index(Ending.RESTED), ENDING_OF_INDEX.index(Ending.BOUNCING)


class Conditions(Protocol):
    """How releases are drawn."""

    def lowest_m(self, die: Die) -> float:
        """The lowest height [m] at which it may release the die's centre."""
        ...

    def states(self, die: Die, count: int, random: np.random.Generator) -> Array:
        """Releases (count, 13): position, quaternion wxyz, velocity, angular velocity, world axes."""
        ...


@dataclass(frozen=True)
class PaperConditions:
    """As in Kapitaniak et al. (2012): z0 uniform (there in [15 a, 20 a]), Euler angles uniform in [0, 2π], no velocity.

    Angles drawn so are not uniform over orientations: they prefer the body's ζ axis near the vertical.
    """

    omega_body_rad_s: tuple[float, float, float]
    """(ω_ξ, ω_η, ω_ζ), the same for every throw."""
    height_m: tuple[float, float]
    """Range of z0."""

    def __post_init__(self) -> None:
        _check_finite("omega_body_rad_s", self.omega_body_rad_s)
        _check_range("height_m", self.height_m)

    def lowest_m(self, die: Die) -> float:
        """[m]"""
        return self.height_m[0]

    def states(self, die: Die, count: int, random: np.random.Generator) -> Array:
        """As `Conditions.states`."""
        drawn = random.random((count, 4))
        numbers = np.zeros((count, len(CONDITIONS)))
        low, high = self.height_m
        numbers[:, 0] = low + (high - low) * drawn[:, 0]
        numbers[:, 1:4] = 2.0 * np.pi * drawn[:, 1:]
        numbers[:, 7:10] = self.omega_body_rad_s
        return states_of(numbers)


@dataclass(frozen=True)
class UniformConditions:
    """Orientation uniform over all rotations, a spin of given size in a uniform direction, no velocity."""

    spin_rad_s: float
    height_m: tuple[float, float]
    """Range of the centre, uniform within."""

    def __post_init__(self) -> None:
        _check_finite("spin_rad_s", (self.spin_rad_s,))
        _check_range("height_m", self.height_m)

    def lowest_m(self, die: Die) -> float:
        """[m]"""
        return self.height_m[0]

    def states(self, die: Die, count: int, random: np.random.Generator) -> Array:
        """As `Conditions.states`."""
        low, high = self.height_m
        states = np.zeros((count, 13))
        states[:, 2] = low + (high - low) * random.random(count)
        # Four normal numbers have no preferred direction (Muller, Comm. ACM 2, 19, 1959).
        quaternions, axes = random.normal(size=(count, 4)), random.normal(size=(count, 3))
        states[:, 3:7] = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
        states[:, 10:13] = self.spin_rad_s * axes / np.linalg.norm(axes, axis=1, keepdims=True)
        return states


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
class Stage:
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
        law = kernels.law_of(self.law.code, self.law.parameters)
        precision = kernels.Precision(self.precision.root_m, self.precision.switch, self.precision.turn_rad)
        cap = BOUNCING_CAP if self.endless else IMPACT_CAP
        starts = kernel_starts(self.die, self.table, states)
        # Of a loaded die under the smooth impact `tops` can prove more: that it spins on for ever.
        plain = self.law.code == kernels.SMOOTH
        if self.die.is_spherical_top or (not plain and self.die.moment_kg_m2 is not None):
            body = body_of(self.die)
            _follow_many(body, law, self.table.plane, precision, starts, cap, landed, lowest)
        else:
            if self.law.code != kernels.SMOOTH:
                raise ValueError(
                    f"{type(self.law).__name__} on a {self.die.solid.name} that is no spherical top: wanted SmoothImpact, "
                    "or a die with one moment of inertia"
                )
            top, turn = tops.top_from_die(self.die)
            starts[:, 3:7] = quat_multiply(starts[:, 3:7], turn)
            _follow_tops(top, law, self.table.plane, precision, starts, cap, landed, lowest)
        endings = np.where(landed[:, 2] < 0, -1, _OF_CODE[landed[:, 2]])
        if self.endless:
            endings[landed[:, 2] == kernels.IMPACT_CAP] = _BOUNCING
        return Landings(landed[:, 0] + 1, landed[:, 1], endings, lowest + 1)


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
    stage: Stage,
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

    `begun` is a tally of the same ensemble to go on from. `chunk`, `threads` and `executor` (see `in_order`) change the
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
    for _, _, part in in_order(work, tally.throws, throws, chunk, threads, executor):
        tally += part
        yield tally


def tally_of(stage: Stage, conditions: Conditions, seed: int, after: int, first: int, end: int) -> Tally:
    """The tally of throws number `first` to `end` - 1 of a seed alone."""
    states = drawn_states(conditions, stage.die, seed, first, end)
    return Tally.of(stage.throw(states, after), len(stage.die.solid.faces))


def drawn_states(conditions: Conditions, die: Die, seed: int, first: int, end: int) -> Array:
    """Releases (end - first, 13) number `first` to `end` - 1 of a seed: the same however they are asked for."""
    parts = []
    for block in range(first // BLOCK, -(-end // BLOCK)):
        random = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(block,))))
        states = conditions.states(die, BLOCK, random)
        parts.append(states[max(first - block * BLOCK, 0) : end - block * BLOCK])
    return np.concatenate(parts) if parts else np.empty((0, 13))


def in_order(
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


def states_of(numbers: Array) -> Array:
    """Releases (n, 13), in world axes, of the paper's initial conditions (n, 10) in the order of CONDITIONS."""
    states = np.zeros((len(numbers), 13))
    _fill_states(np.ascontiguousarray(numbers, float), states)
    return states


def check_releases(stage: Stage, conditions: Conditions) -> None:
    """Raises ValueError for conditions that could release the die below the table."""
    lowest_m = conditions.lowest_m(stage.die)
    height = lowest_m * cos(stage.table.tilt_rad) - (stage.table.amplitude_m if stage.table.moves else 0.0)
    radius = stage.die.solid.circumradius
    if not height >= radius:
        raise ValueError(
            f"releases from a height of {lowest_m:.6g} m: the die reaches {radius:.6g} m from its centre, so that it could "
            "begin below the table; wanted a higher lowest release"
        )


def _check_finite(name: str, values: tuple[float, ...]) -> None:
    if not np.isfinite(values).all():
        raise ValueError(f"{name} = {values}: wanted finite numbers")


def _check_range(name: str, values: tuple[float, float]) -> None:
    _check_finite(name, values)
    if values[0] > values[1]:
        raise ValueError(f"{name} = {values}: wanted the lower bound first")


# --- kernels -----------------------------------------------------------------------------------------------------


@compiled
def _fill_states(numbers: Array, states: Array) -> None:
    """Number by number, so that a release does not depend on those beside it in the last bit."""
    for k in range(numbers.shape[0]):
        psi, theta, phi = 0.5 * numbers[k, 1], 0.5 * numbers[k, 2], 0.5 * numbers[k, 3]
        # R = Rz(ψ) Rx(ϑ) Rz(φ)
        w, x = cos(theta) * cos(psi + phi), sin(theta) * cos(psi - phi)
        y, z = sin(theta) * sin(psi - phi), cos(theta) * sin(psi + phi)
        a, b, c = numbers[k, 7], numbers[k, 8], numbers[k, 9]
        tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
        states[k, 2] = numbers[k, 0]
        states[k, 3], states[k, 4], states[k, 5], states[k, 6] = w, x, y, z
        states[k, 7], states[k, 8], states[k, 9] = numbers[k, 4], numbers[k, 5], numbers[k, 6]
        states[k, 10] = a + w * tx + y * tz - z * ty
        states[k, 11] = b + w * ty + z * tx - x * tz
        states[k, 12] = c + w * tz + x * ty - y * tx


# Those that follow are compiled anew in every process, which takes a second: kept in the cache of this file they would
# go on calling event loops of yesterday, because the cache does not see edits of another file.


@njit
def _note_lowest(normals: Array, log: Array, end: Array, lowest: Indices) -> None:
    """Rows of the lowest faces (after,) at the logged impacts, and at the end where there are fewer."""
    known = 0
    for event in range(log.shape[0]):
        if log[event, 1] >= 0.0 and known < lowest.shape[0]:
            lowest[known] = kernels.lowest_row(normals, log[event, 2:15])
            known += 1
    for k in range(known, lowest.shape[0]):
        lowest[k] = kernels.lowest_row(normals, end)


@njit(nogil=True)
def _follow_many(
    body: kernels.Body,
    law: kernels.Law,
    plane: kernels.Plane,
    precision: kernels.Precision,
    starts: Array,
    impact_cap: int,
    landed: Indices,
    lowest: Indices,
) -> None:
    """Throw from every row of `starts` (n, 13); fills `landed` (n, 3) with face row or -1, impacts and code of the
    ending (-1: below the table), and `lowest` (n, 1 + after) with rows of faces."""
    z_table, after = kernels.table_height(plane, 0.0), lowest.shape[1] - 1
    for k in range(starts.shape[0]):
        lowest[k, 0] = kernels.lowest_row(body.normals, starts[k])
        deep = inf
        for i in range(body.vertices.shape[0]):
            deep = min(deep, kernels.clearance(body.vertices[i], starts[k], z_table))
        if deep < -1e-9 * body.radius:
            landed[k, 0], landed[k, 1], landed[k, 2] = -1, 0, -1
            continue
        code, impacts, face, _, _, _, _ = kernels.run_throw(
            body, law, plane, precision, starts[k], 0.0, inf, kernels.NO_LIMIT, kernels.YES, impact_cap, kernels.NO
        )
        landed[k, 0], landed[k, 1], landed[k, 2] = face, impacts, code
        if after > 0:
            _, _, _, _, end, log, _ = kernels.run_throw(
                body, law, plane, precision, starts[k], 0.0, inf, after, kernels.YES, impact_cap, kernels.YES
            )
            _note_lowest(body.normals, log, end, lowest[k, 1:])


@njit(nogil=True)
def _follow_tops(
    top: tops.Top,
    law: kernels.Law,
    plane: kernels.Plane,
    precision: kernels.Precision,
    starts: Array,
    impact_cap: int,
    landed: Indices,
    lowest: Indices,
) -> None:
    """As `_follow_many`, for dice that are no spherical tops; states of the centre of mass, principal axes."""
    z_table, after = kernels.table_height(plane, 0.0), lowest.shape[1] - 1
    for k in range(starts.shape[0]):
        lowest[k, 0] = kernels.lowest_row(top.normals, starts[k])
        deep = inf
        for i in range(top.vertices.shape[0]):
            deep = min(deep, kernels.clearance(top.vertices[i], starts[k], z_table))
        if deep < -1e-9 * top.radius:
            landed[k, 0], landed[k, 1], landed[k, 2] = -1, 0, -1
            continue
        code, impacts, face, _, _, _, _ = tops.run_top(
            top, law, plane, precision, starts[k], 0.0, inf, kernels.NO_LIMIT, kernels.YES, impact_cap, kernels.NO
        )
        landed[k, 0], landed[k, 1], landed[k, 2] = face, impacts, code
        if after > 0:
            _, _, _, _, end, log, _ = tops.run_top(
                top, law, plane, precision, starts[k], 0.0, inf, after, kernels.YES, impact_cap, kernels.YES
            )
            _note_lowest(top.normals, log, end, lowest[k, 1:])
