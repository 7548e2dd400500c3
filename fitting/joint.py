"""Many throws of one die on one table: what they share, fitted so that it foretells throws that were not in the fit.

**What is minimised.** Each throw starts from the state that its frames before the first bounce give (`outset`), which the
later frames do not move, and is simulated on to its last frame. What a frame misses by is the distance d by which the
die's mass points are off in the root mean square, d² = |δp|² + (J/m)|δ|² (δp [m] of the centre, δ [rad] the turn). The
cost is the mean over throws of their mean over frames of √(d² + s²) - s, s what the errors of the start leave open.

- Why whole throws: a law that fits single impacts best need not foretell best. Where a law misses by far more than the
  frames err, the likelihood of the frames asks for whatever absorbs the first impact's residuals to the last micron.
- Why distances, not their squares: one throw in five takes another course sooner or later, and is then off by an edge
  whatever the parameters are. Squares would serve those throws alone.
- Why the start is held: the frames before the first bounce fix it far better than the law foretells what follows. Freed,
  it would bend to excuse the law, as no prediction can.

With the starts held there is one set of unknowns for all throws, and the normal equations are a sum over throws of k × k
blocks: the cost grows with the number of throws, no more. They are solved by iterated reweighting (Holland & Welsch,
Comm. Stat. A 6, 813, 1977) with Marquardt's damping. Derivatives are differences over steps as large as the parameters
are ever known (`_STEPS`), since the course of a throw jumps where a corner touches or just does not; frames that jump
within a step tell nothing of a slope, and are left out of it.

**Which effects.** From the paper's law on, one at a time (`selection` does the same for one throw). Throws are dealt into
five folds, and each is foretold with parameters fitted to the other folds (one step of the same method from the common
fit, by the blocks of those throws). An effect is taken in if that lowers the cost of throws, compared throw by throw,
by more than Student's t allows chance.

**Intervals** by bootstrap over throws (Efron & Tibshirani, An Introduction to the Bootstrap, 1993, ch. 6 and 13): whole
throws are drawn with replacement, and each set makes the same step. They hold what throws scatter, and no symmetry is
asked for. **Scatter** of χ between throws: how far each throw alone, by its frames up to the second bounce, would move
it, robustly, less what the errors of the starts account for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from ..model.motion import State
from ..model.rotations import rotation_between
from ..model.solids import Die
from ..model.tables import LEVEL, Table
from ..tracking.track import Track
from .flights import moved_state
from .outset import FEWEST, Outset, first_bounce_row, flight_length, outset_before, usable_rows
from .physics import Physics
from .prediction import simulated_throws
from .results import Effect, Parameter

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

LEVEL_OF_INTERVALS = 0.95

EFFECTS: dict[str, tuple[str, ...]] = {
    "friction": ("mu",),
    "rounded corners": ("corner_radius_m",),
    "inertia": ("inertia_kg_m2",),
    "fading restitution": ("chi_fade_s_per_m",),
    "fading friction": ("mu_fade_s_per_m",),
    "clock": ("clock_scale",),
}
"""Effects on trial and their parameters."""

_NEEDS = {"fading friction": "mu"}
"""Parameters without which an effect is none."""

_STEPS = {"chi": 0.01, "mu": 0.005, "chi_fade_s_per_m": 0.05, "mu_fade_s_per_m": 0.05, "clock_scale": 1e-3}
"""Steps of the differences; of a radius and an inertia `_RADIUS_STEP` and `_INERTIA_STEP` of the die's own."""

_RADIUS_STEP, _INERTIA_STEP = 0.01, 0.02

_FIRST_CHI = (0.2, 0.35, 0.5, 0.65, 0.8, 0.95)
_FIRST_MU = (0.1, 0.2, 0.4)
"""Where the first fit looks, so that no start is asked for."""

_FOR_EFFECTS = 32
"""Throws by which effects are chosen, spread over all: enough to tell what a tenth of the cost is worth."""

_FOR_FIRST = 8
"""Throws by which the first parameters are looked for."""

_FOLDS = 5
_MOST_ROUNDS = 12
_CONVERGED, _CONVERGED_ENOUGH = 1e-4, 3e-3
"""Part of the cost by which a step must lower it to be followed by another; and where only an effect is to be judged."""

_JUMP = 0.3
"""Part of the circumradius by which a pose moves within one step of a difference where the throw has jumped course."""

_START_DRAWS = 4
_BOOTSTRAP_DRAWS = 1000
_SURE = 0.95
"""Confidence with which an effect must pay."""


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


@dataclass(frozen=True, eq=False)
class Foretold:
    """How a throw came out when parameters fitted to other throws foretold it."""

    name: str
    first_bounce_frame: int
    """Frame number of the first frame after the first bounce."""
    frames_before: int
    frames_after: int
    position_error_m: float
    """Mean over the frames after the first bounce."""
    rotation_error_rad: float
    chi: float | None
    """What this throw alone asks for, up to its second bounce; None where no frame tells."""


@dataclass(frozen=True, eq=False)
class JointFit:
    """What many throws share."""

    physics: Physics
    parameters: dict[str, Parameter]
    chosen: tuple[Effect, ...]
    considered: tuple[Effect, ...]
    throws: tuple[Foretold, ...]
    chi_scatter: float | None
    """Standard deviation of χ between throws, beyond what the errors of the frames account for."""
    messages: tuple[str, ...]


def entry_of(name: str, track: Track, die: Die) -> Entry:
    """A throw as a joint fit wants it. Raises ValueError, with the name, where its track does not allow it."""
    try:
        row = first_bounce_row(track, die)
        rows = usable_rows(track)
        outset = outset_before(track, die, row)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
    after = rows[rows >= row]
    early = flight_length(track, die, after) if len(after) >= FEWEST else len(after)
    return Entry(name, track, after, early, outset)


def fit_jointly(
    entries: Sequence[Entry],
    die: Die,
    table: Table = LEVEL,
    *,
    threads: int = 1,
    effects: Sequence[str] = tuple(EFFECTS),
    progress: Progress = lambda done, total: None,
) -> JointFit:
    """The parameters that all throws share, with the effects that pay in throws that were not in the fit.

    `effects` are those on trial. Raises ValueError for fewer than two throws.
    """
    if len(entries) < 2:
        raise ValueError(f"{len(entries)} throws with a first bounce; wanted at least two for a joint fit")
    with ThreadPoolExecutor(threads) as pool:
        spread = _spread(entries, _FOR_EFFECTS)
        told = _Told(progress, 3 * len(effects) + 2)
        plainest = Physics(die, table, {"chi": 0.5})
        some = _with_slack(spread, plainest, pool)
        best = _descended(some, _first(some, plainest))
        told.step()
        best, chosen, refused = _with_effects(some, best, effects, told)
        everyone = _with_slack(entries, best.physics, pool)
        best = _descended(everyone, best.physics)
        told.end()
        return _result(everyone, best, chosen, refused)


# --- the crowd of throws and its cost ---


@dataclass(frozen=True, eq=False)
class _Crowd:
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

    def misses(self, physics: Sequence[Physics], starts: Sequence[State] | None = None) -> list[Array]:
        """(n, 6) [m] of every throw: seen less simulated, turns times the radius of gyration; each by its own physics,
        from the states of the outsets unless others are given."""
        states = [entry.outset.state for entry in self.entries] if starts is None else starts
        found: list[Array] = [np.empty((0, 6))] * len(self.entries)
        for one in {id(p): p for p in physics}.values():
            mine = [k for k, p in enumerate(physics) if p is one]
            entries = [self.entries[k] for k in mine]
            together = _misses(entries, one, [states[k] for k in mine], self.arm_m, self.pool)
            lengths = np.cumsum([len(entry.rows) for entry in entries])[:-1]
            for k, part in zip(mine, np.split(together, lengths), strict=True):
                found[k] = part
        return found

    def costs(self, misses: Sequence[Array]) -> Array:
        """(throws,) [m]."""
        return np.array([_cost(r, s) for r, s in zip(misses, self.slack, strict=True)])


@dataclass(frozen=True, eq=False)
class _Point:
    """Physics at which a crowd has been seen."""

    physics: Physics
    misses: list[Array]
    costs: Array
    blocks: Array
    """(throws, k, k) normal equations of each throw, in steps of the parameters."""
    pulls: Array
    """(throws, k) their right sides."""
    slopes: list[Array]
    """(n, 6, k) of each throw."""

    @property
    def steps(self) -> Array:
        """(k,) units of the parameters."""
        return np.array([_step_of(self.physics, name) for name in self.physics.free])

    def moved(self, throws: NDArray[np.bool_] | NDArray[np.int64], damping: float = 0.0) -> Physics:
        """The physics after one step by the normal equations of some throws."""
        matrix, right = self.blocks[throws].sum(0), self.pulls[throws].sum(0)
        return self.physics.moved(self.steps * _solved(matrix, right, damping))


def _misses(
    entries: Sequence[Entry], physics: Physics, states: Sequence[State], arm_m: float, pool: ThreadPoolExecutor
) -> Array:
    """(Σ n, 6) of several throws, one below the other."""
    positions, quaternions = simulated_throws(physics, states, [entry.times_s for entry in entries], pool)
    seen = np.concatenate([entry.track.position_m[entry.rows] for entry in entries])
    turned = rotation_between(quaternions, np.concatenate([entry.track.quaternion[entry.rows] for entry in entries]))
    misses = np.hstack([seen - positions, arm_m * turned])
    # A throw that bounces on without end is given up: as far off as a die can be that lies where it should.
    return np.where(np.isfinite(misses), misses, np.pi * arm_m)


def _cost(misses: Array, slack: Array) -> float:
    return float(np.mean(np.sqrt((misses**2).sum(1) + slack**2) - slack))


def _with_slack(entries: Sequence[Entry], physics: Physics, pool: ThreadPoolExecutor) -> _Crowd:
    """The crowd, each frame with how far the errors of the start let it stray, and with its own error."""
    bare = _Crowd(tuple(entries), physics.die, pool, ())
    everyone = [physics] * len(entries)
    plain = bare.misses(everyone)
    squares = [np.zeros(len(entry.rows)) for entry in entries]
    for starts in _drawn_starts(entries):
        for k, strayed in enumerate(bare.misses(everyone, starts)):
            squares[k] += ((strayed - plain[k]) ** 2).sum(1) / _START_DRAWS
    noise = [3.0 * (e.outset.sigma_m**2 + (bare.arm_m * e.outset.sigma_rad) ** 2) for e in entries]
    return replace(bare, slack=tuple(np.sqrt(s + n) for s, n in zip(squares, noise, strict=True)))


def _drawn_starts(entries: Sequence[Entry]) -> list[list[State]]:
    """Starts that the frames of each throw allow as well, `_START_DRAWS` times."""
    rng = np.random.default_rng(0)
    draws: list[list[State]] = [[] for _ in range(_START_DRAWS)]
    for entry in entries:
        values, axes = np.linalg.eigh(entry.outset.covariance)
        spread = axes * np.sqrt(np.clip(values, 0.0, None))
        for drawn in draws:
            drawn.append(moved_state(entry.outset.state, spread @ rng.standard_normal(12)))
    return draws


# --- descent ---


def _first(crowd: _Crowd, physics: Physics) -> Physics:
    """The paper's law with the χ of least cost, of a few."""
    few = _some(crowd, _FOR_FIRST)
    return min((physics.with_values(chi=chi) for chi in _FIRST_CHI), key=lambda p: _mean_cost(few, p))


def _descended(crowd: _Crowd, physics: Physics, converged: float = _CONVERGED) -> _Point:
    """The physics of least cost, from a start."""
    point, damping = _seen(crowd, physics), 1e-2
    everyone = np.ones(len(crowd.entries), bool)
    for _ in range(_MOST_ROUNDS):
        trial = point.moved(everyone, damping)
        gain = 1.0 - _mean_cost(crowd, trial) / max(float(point.costs.mean()), 1e-300)
        if gain > 0.0:
            point, damping = _seen(crowd, trial), 0.2 * damping
            if gain < converged:
                break
        elif damping > 10.0:
            break
        else:
            damping *= 30.0
    return point


def _mean_cost(crowd: _Crowd, physics: Physics) -> float:
    return float(crowd.costs(crowd.misses([physics] * len(crowd.entries))).mean())


def _seen(crowd: _Crowd, physics: Physics) -> _Point:
    """Cost and derivatives at some physics."""
    count = len(crowd.entries)
    here = crowd.misses([physics] * count)
    slopes: list[list[Array]] = [[] for _ in here]
    for name in physics.free:
        step = _step_of(physics, name)
        _, high = physics.bounds(name)
        sign = 1.0 if physics.values[name] + step <= high else -1.0
        there = crowd.misses([physics.with_values(**{name: physics.values[name] + sign * step})] * count)
        for k in range(count):
            slopes[k].append(-sign * (there[k] - here[k]))
    jump = _JUMP * physics.die.solid.circumradius
    jacobians = [_without_jumps(np.stack(columns, axis=2), jump) for columns in slopes]
    weighted = [_equations(r, j, s) for r, j, s in zip(here, jacobians, crowd.slack, strict=True)]
    blocks, pulls = np.array([w[0] for w in weighted]), np.array([w[1] for w in weighted])
    return _Point(physics, here, crowd.costs(here), blocks, pulls, jacobians)


def _without_jumps(slopes: Array, jump_m: float) -> Array:
    """Slopes (n, 6, k) with the frames from the first jump on set to zero: what follows is another course."""
    jumped = (np.linalg.norm(slopes, axis=1) > jump_m).any(1)
    first = int(np.argmax(jumped)) if jumped.any() else len(slopes)
    kept = slopes.copy()
    kept[first:] = 0.0
    return kept


def _equations(misses: Array, slopes: Array, slack: Array) -> tuple[Array, Array]:
    """Normal equations (k, k) and (k,) of one throw, its frames weighted so that squares stand for distances."""
    weight = 1.0 / np.sqrt((misses**2).sum(1) + slack**2) / len(misses)
    weighted = slopes * weight[:, None, None]
    return np.einsum("nij,nik->jk", weighted, slopes), np.einsum("nij,ni->j", weighted, misses)


def _solved(matrix: Array, right: Array, damping: float) -> Array:
    damped = matrix + damping * np.diag(np.diag(matrix))
    scale = np.sqrt(np.maximum(np.diag(damped), 1e-300))
    return np.asarray(np.linalg.lstsq(damped / np.outer(scale, scale), right / scale, rcond=1e-12)[0] / scale)


def _step_of(physics: Physics, name: str) -> float:
    if name == "corner_radius_m":
        return _RADIUS_STEP * physics.die.solid.inradius
    return _INERTIA_STEP * physics.die.inertia_kg_m2 if name == "inertia_kg_m2" else _STEPS[name]


# --- effects ---


@dataclass
class _Told:
    """Steps of a progress bar."""

    progress: Progress
    total: int
    done: int = 0

    def step(self) -> None:
        """One more; never the last."""
        self.done = min(self.done + 1, self.total - 1)
        self.progress(self.done, self.total)

    def end(self) -> None:
        """All."""
        self.progress(self.total, self.total)


def _with_effects(
    crowd: _Crowd, point: _Point, effects: Sequence[str], told: _Told
) -> tuple[_Point, list[Effect], list[Effect]]:
    """Effects taken in while they pay, the one that pays most first; then what was chosen and what was not."""
    chosen: list[Effect] = []
    left = list(effects)
    refused: dict[str, Effect] = {}
    while left:
        # What errors of the start do depends on the law: tell it anew.
        crowd = _with_slack(crowd.entries, point.physics, crowd.pool)
        point = _seen(crowd, point.physics)
        before = _left_out_costs(crowd, point)
        trials = {}
        for effect in left:
            if _NEEDS.get(effect, "chi") not in point.physics.values:
                refused[effect] = Effect(effect, None, f"Not tried: there is no {_NEEDS[effect]} for it to act on.")
                continue
            wider = _widened(crowd, point, effect)
            trials[effect] = (wider, before - _left_out_costs(crowd, wider))
            told.step()
        paying = {e: gains for e, (_, gains) in trials.items() if gains.mean() > _price(gains)}
        for effect, (_, gains) in trials.items():
            if effect not in paying:
                refused[effect] = _refusal(effect, gains, before)
        if not paying:
            break
        best = max(paying, key=lambda e: float(paying[e].mean()))
        chosen.append(Effect(best, _evidence(paying[best]), None))
        refused.pop(best, None)
        point = trials[best][0]
        left = [effect for effect in left if effect != best]
    return point, chosen, [refused[effect] for effect in left if effect in refused]


def _widened(crowd: _Crowd, point: _Point, effect: str) -> _Point:
    """The fit with one effect more, from a little of it."""
    wider = (
        point.physics.with_effect(effect) if effect in _IN_ONE_THROW else point.physics.with_values(mu_fade_s_per_m=0.1)
    )
    few = _some(crowd, _FOR_FIRST)
    starts = [wider]
    if effect == "friction":
        starts = [wider.with_values(mu=mu, chi=chi) for mu in _FIRST_MU for chi in _FIRST_CHI[:-1]]
    elif effect == "rounded corners":
        starts = [wider.with_values(corner_radius_m=part * wider.die.solid.inradius) for part in (0.02, 0.08, 0.2)]
    elif effect == "fading restitution":
        starts = [wider.with_values(chi_fade_s_per_m=fade) for fade in (0.1, 1.0)]
    elif effect == "fading friction":
        starts = [wider.with_values(mu_fade_s_per_m=fade) for fade in (0.1, 1.0)]
    return _descended(
        crowd, min(starts, key=lambda p: _mean_cost(few, p)) if len(starts) > 1 else wider, _CONVERGED_ENOUGH
    )


_IN_ONE_THROW = tuple(effect for effect in EFFECTS if effect != "fading friction")
"""Effects that `physics` knows how to add by name."""


def _left_out_costs(crowd: _Crowd, point: _Point) -> Array:
    """(throws,) cost of each throw with the parameters that the throws of the other folds ask for."""
    count = len(crowd.entries)
    fold = np.arange(count) % min(_FOLDS, count)
    moved = [point.moved(fold != k) for k in range(int(fold.max()) + 1)]
    return crowd.costs(crowd.misses([moved[k] for k in fold]))


def _price(gains: Array) -> float:
    """What gains (throws,) must have as their mean not to be chance."""
    return float(student.ppf(_SURE, len(gains) - 1) * gains.std(ddof=1) / np.sqrt(len(gains)))


def _evidence(gains: Array) -> float:
    """Units of log-likelihood by which throws left out are foretold better, were the mean gain normally distributed."""
    error = float(gains.std(ddof=1)) / np.sqrt(len(gains))
    return 0.5 * (float(gains.mean()) / max(error, 1e-300)) ** 2 * float(np.sign(gains.mean()))


def _refusal(effect: str, gains: Array, before: Array) -> Effect:
    part, error = gains.mean() / before.mean(), gains.std(ddof=1) / np.sqrt(len(gains)) / before.mean()
    if gains.mean() <= 0.0:
        why = f"It foretells throws left out of the fit worse, by {-100 * part:.2g} % of their error."
    else:
        why = (
            f"It foretells throws left out of the fit better by {100 * part:.2g} % of their error, with a standard error "
            f"of {100 * error:.2g} %: no more than chance."
        )
    return Effect(effect, _evidence(gains), why)


# --- the result ---


def _result(crowd: _Crowd, point: _Point, chosen: list[Effect], refused: list[Effect]) -> JointFit:
    misses = _left_out_misses(crowd, point)
    chi, scatter = _scatter(crowd, point)
    throws = tuple(
        Foretold(
            entry.name,
            int(entry.track.frame[entry.rows[0]]),
            len(entry.outset.rows),
            len(entry.rows),
            float(np.linalg.norm(miss[:, :3], axis=1).mean()),
            float(np.linalg.norm(miss[:, 3:], axis=1).mean() / crowd.arm_m),
            None if not np.isfinite(own) else float(own),
        )
        for entry, miss, own in zip(crowd.entries, misses, chi, strict=True)
    )
    return JointFit(
        point.physics,
        _parameters(point),
        tuple(chosen),
        tuple(refused),
        throws,
        scatter,
        _messages(crowd, throws, chosen, scatter),
    )


def _left_out_misses(crowd: _Crowd, point: _Point) -> list[Array]:
    count = len(crowd.entries)
    fold = np.arange(count) % min(_FOLDS, count)
    moved = [point.moved(fold != k) for k in range(int(fold.max()) + 1)]
    return crowd.misses([moved[k] for k in fold])


def _parameters(point: _Point) -> dict[str, Parameter]:
    """Values with intervals, by drawing throws."""
    rng, count = np.random.default_rng(0), len(point.costs)
    drawn = []
    for _ in range(_BOOTSTRAP_DRAWS):
        drawn.append(list(point.moved(rng.integers(0, count, count)).values.values()))
    tail = 50.0 * (1.0 - LEVEL_OF_INTERVALS)
    low, high = np.percentile(drawn, [tail, 100.0 - tail], axis=0)
    found = {}
    for k, (name, value) in enumerate(point.physics.values.items()):
        bounds = point.physics.bounds(name)
        at_bound = bool(min(abs(value - bounds[0]), abs(value - bounds[1])) < 1e-9)
        found[name] = Parameter(
            value, min(float(low[k]), value), max(float(high[k]), value), LEVEL_OF_INTERVALS, True, at_bound
        )
    return found


def _scatter(crowd: _Crowd, point: _Point) -> tuple[Array, float | None]:
    """χ that each throw alone asks for (NaN where no frame tells), and its scatter beyond errors of the starts."""
    which = point.physics.free.index("chi")
    count = len(crowd.entries)
    strayed = [crowd.misses([point.physics] * count, starts) for starts in _drawn_starts(crowd.entries)]
    own, noise = np.full(count, np.nan), np.full(count, np.nan)
    for k, entry in enumerate(crowd.entries):
        slope = point.slopes[k][: entry.early, :, which]
        weight = 1.0 / (crowd.slack[k][: entry.early] ** 2)[:, None]
        bottom = float((weight * slope**2).sum())
        if bottom <= 0.0:
            continue
        own[k] = float((weight * slope * point.misses[k][: entry.early]).sum()) / bottom
        errors = [float((weight * slope * (s[k] - point.misses[k])[: entry.early]).sum()) / bottom for s in strayed]
        noise[k] = float(np.mean(np.square(errors)))
    step, told = _step_of(point.physics, "chi"), np.isfinite(own)
    values = point.physics.values["chi"] + step * own
    if told.sum() < 3:
        return values, None
    # 1.4826 times the median deviation is the standard deviation of normal numbers.
    total = (1.4826 * float(np.median(np.abs(own[told] - np.median(own[told])))) * step) ** 2
    return values, float(np.sqrt(max(0.0, total - step**2 * float(np.median(noise[told])))))


def _messages(
    crowd: _Crowd, throws: Sequence[Foretold], chosen: Sequence[Effect], scatter: float | None
) -> tuple[str, ...]:
    edge = float(np.linalg.norm(np.diff(crowd.die.solid.vertices[crowd.die.solid.edges[0]], axis=0)))
    position = float(np.mean([t.position_error_m for t in throws]))
    turned = float(np.degrees(np.mean([t.rotation_error_rad for t in throws])))
    words = [
        f"Parameters are those that foretell whole throws best: fitted to the other throws, they miss by "
        f"{100 * position / edge:.3g} % of the edge and {turned:.3g} degrees, in the mean over throws and over the frames "
        "after the first bounce.",
        "Effects in the model: " + (", ".join(effect.name for effect in chosen) or "none beyond the paper's law") + ".",
    ]
    if scatter is not None:
        words.append(f"From throw to throw chi scatters by {scatter:.2g} beyond the errors of the frames.")
    return tuple(words)


def _spread(entries: Sequence[Entry], count: int) -> Sequence[Entry]:
    """At most so many of them, evenly spread."""
    if len(entries) <= count:
        return entries
    return [entries[k] for k in np.linspace(0, len(entries) - 1, count).round().astype(int)]


def _some(crowd: _Crowd, count: int) -> _Crowd:
    if len(crowd.entries) <= count:
        return crowd
    which = np.linspace(0, len(crowd.entries) - 1, count).round().astype(int)
    return replace(crowd, entries=tuple(crowd.entries[k] for k in which), slack=tuple(crowd.slack[k] for k in which))
