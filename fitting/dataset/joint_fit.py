"""Many throws of one die on one table: what they share, fitted so that it foretells throws that were not in the fit.

**What is minimised.** Each throw starts from the state that its frames before the first bounce give (`outset`), which the
later frames do not move, and is simulated on to its last frame. The cost is the mean over throws of their mean over frames
of the distance by which the die's mass points are off, less what the errors of the start leave open (`crowd`).

- Why whole throws: a law that fits single impacts best need not foretell best. Where a law misses by far more than the
  frames err, the likelihood of the frames asks for whatever absorbs the first impact's residuals to the last micron.
- Why distances, not their squares: one throw in five takes another course sooner or later, and is then off by an edge
  whatever the parameters are. Squares would serve those throws alone.
- Why the start is held: the frames before the first bounce fix it far better than the law foretells what follows. Freed,
  it would bend to excuse the law, as no prediction can.

`joint_descent` finds the least cost, `joint_effects` what belongs in the model at all.

**Intervals** by bootstrap over throws (Efron & Tibshirani, An Introduction to the Bootstrap, 1993, ch. 6 and 13): whole
throws are drawn with replacement, and each set makes one more step. They hold what throws scatter, and no symmetry is
asked for. **Scatter** of χ between throws: how far each throw alone, by its frames up to the second bounce, would move
it, robustly, less what the errors of the starts account for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.laws import LEVEL, Table
from ..results import Effect, Parameter
from ..throw import Physics
from .data_set import Crowd, Entry, crowd_of, drawn_strays, spread
from .joint_effects import EFFECTS, FIRST_CHI, FOR_FIRST, with_effects
from .least_cost import Point, descended, left_out_misses, step_of

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

LEVEL_OF_INTERVALS = 0.95

_FOR_EFFECTS = 32
"""Throws by which effects are chosen, spread over all: enough to tell what a tenth of the cost is worth."""

_BOOTSTRAP_DRAWS = 1000


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
    told = _Told(progress, 3 * len(effects) + 2)
    with ThreadPoolExecutor(threads) as pool:
        plainest = Physics(die, table, {"chi": 0.5})
        some = crowd_of([entries[k] for k in spread(len(entries), _FOR_EFFECTS)], plainest, pool)
        few = some.some(FOR_FIRST)
        best = descended(some, min((plainest.with_values(chi=chi) for chi in FIRST_CHI), key=few.mean_cost))
        told.step()
        best, chosen, refused = with_effects(some, best, effects, told.step)
        everyone = crowd_of(entries, best.physics, pool)
        best = descended(everyone, best.physics)
        told.end()
        return _result(everyone, best, chosen, refused)


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


def _result(crowd: Crowd, point: Point, chosen: list[Effect], refused: list[Effect]) -> JointFit:
    misses = left_out_misses(crowd, point)
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


def _parameters(point: Point) -> dict[str, Parameter]:
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


def _scatter(crowd: Crowd, point: Point) -> tuple[Array, float | None]:
    """χ that each throw alone asks for (NaN where no frame tells), and its scatter beyond errors of the starts."""
    which = point.physics.free.index("chi")
    count = len(crowd.entries)
    strayed = [crowd.misses(point.physics, strays) for strays in drawn_strays(crowd.entries)]
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
    step, told = step_of(point.physics, "chi"), np.isfinite(own)
    values = point.physics.values["chi"] + step * own
    if told.sum() < 3:
        return values, None
    # 1.4826 times the median deviation is the standard deviation of normal numbers.
    total = (1.4826 * float(np.median(np.abs(own[told] - np.median(own[told])))) * step) ** 2
    return values, float(np.sqrt(max(0.0, total - step**2 * float(np.median(noise[told])))))


def _messages(
    crowd: Crowd, throws: Sequence[Foretold], chosen: Sequence[Effect], scatter: float | None
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
