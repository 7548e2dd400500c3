"""Joint fit of many throws of one die on one table: the shared parameters that predict left-out throws best.

**Cost.** Each throw starts from its release state, which follows from the frames before the first bounce and is not moved
by later ones, and is simulated to its last frame. The cost is the mean over throws of their mean over frames of the
distance by which the die's mass points are off, less what the errors of the release state allow (`data_set`).

- Whole throws: the law that fits single impacts best need not predict best. Where a law errs by far more than the frames,
  the likelihood of the frames selects whatever absorbs the first impact's residuals to the last micron.
- Distances, not squares: one throw in five sooner or later takes another path, and is then off by an edge whatever the
  parameters are. Squares would fit those throws alone.
- Fixed release states: the frames before the first bounce determine them far better than the law predicts what follows.
  If they were free, they would compensate errors of the law, which no prediction can do.

`flight_evidence` decides centre of mass and clock, `joint_effects` what else belongs in the model, `search` finds the
least of several minima, and the intervals, from what random halves of the throws find.

**Scatter** of χ between throws: the robust standard deviation of the χ that each throw alone would give by its frames up to the
second bounce, less the share of the errors of the release states.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ...model.die import Die
from ...model.errors import InputError
from ...model.laws import Table
from ..results import Effect, Misfit, Parameter, ParameterCovariance
from ..throw import INTERVAL_LEVEL, Physics, table_under
from .data_set import DataSet, Entry, data_set_of, drawn_perturbations, evenly_spread
from .flight_evidence import FlightEstimate, with_flight_effects
from .joint_effects import EFFECTS, FIRST_CHI, IMPACT_EFFECTS, START_THROWS, least_evidence, with_effects
from .minimisation import Linearisation, left_out_residuals, linearised_at, minimised, step_of
from .search import SPLITS, STARTS, Minimum, Spread, best_of_minima, spread_of

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

_EFFECT_THROWS = 120
"""Most throws, spread over all, by which effects are chosen: more would take longer in proportion."""

_CORRELATED = 0.8
"""Correlation from which two parameters are reported to trade against each other."""

_MISFIT_TIMES = 8
"""Times at which the misfit is tabulated, each for as many frames."""

_BOUND_TOLERANCE = 1e-9
"""Distance from a bound at which a value stands on it."""

_MIN_FOR_SCATTER = 3
"""Throws whose χ is known from which their scatter is estimated."""

_NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True, eq=False)
class PredictedThrow:
    """One throw, predicted with parameters fitted to other throws."""

    name: str
    first_bounce_frame: int
    """Frame number of the first frame after the first bounce."""
    frames_before: int
    frames_after: int
    position_error_m: float
    """Mean over the frames after the first bounce."""
    rotation_error_rad: float
    """The same."""
    chi: float | None
    """χ from this throw alone, up to its second bounce; None where its frames have no information on it."""


@dataclass(frozen=True, eq=False)
class JointFit:
    """The shared parameters of many throws."""

    physics: Physics
    parameters: dict[str, Parameter]
    chosen: tuple[Effect, ...]
    considered: tuple[Effect, ...]
    throws: tuple[PredictedThrow, ...]
    chi_scatter: float | None
    """Standard deviation of χ between throws, beyond the errors of the frames."""
    messages: tuple[str, ...]
    minima: tuple[Minimum, ...]
    """Minima of the cost, the best first."""
    covariance: ParameterCovariance
    """Of all free parameters; those of the flights are independent of those of the impacts."""
    misfit: Misfit
    """Of throws left out of the fit."""


def fit_jointly(
    entries: Sequence[Entry],
    die: Die,
    table: Table | None = None,
    *,
    threads: int = 1,
    effects: Sequence[str] = tuple(EFFECTS),
    progress: Progress = lambda done, total: None,
) -> JointFit:
    """The parameters that all throws share, with the effects that predict left-out throws better.

    `effects` are those on trial. Without a `table` it is level and at rest. Raises ValueError for fewer than two throws, and for
    throws under different gravity.
    """
    if len(entries) < 2:
        raise InputError(f"{len(entries)} throws with a first bounce; wanted at least two for a joint fit")
    tables = [table_under(entry.track, table) for entry in entries]
    if len(set(tables)) > 1:
        raise InputError("the tracks were filmed where gravity differs; wanted throws of one place")
    impact_effects = [effect for effect in effects if effect in IMPACT_EFFECTS]
    steps = _Steps(progress, 3 * len(impact_effects) + 2 + STARTS + SPLITS)
    least = least_evidence(max(len(effects), 1), len(entries))
    plainest, estimates, shown, absent = with_flight_effects(
        entries, Physics(die, tables[0], {"chi": 0.5}), effects, least
    )
    with ThreadPoolExecutor(threads) as pool:
        some = data_set_of([entries[k] for k in evenly_spread(len(entries), _EFFECT_THROWS)], plainest, pool)
        starts = (plainest.with_values(chi=chi) for chi in FIRST_CHI)
        best = minimised(some, min(starts, key=some.subset(START_THROWS).mean_cost))
        steps.advance()
        effects_shown = with_effects(some, best, impact_effects, steps.advance)
        everyone = data_set_of(entries, effects_shown.point.physics, pool)
        points, minima = best_of_minima(everyone, effects_shown.point.physics, steps.advance)
        spread, best = spread_of(everyone, points, effects_shown, steps.advance), points[0]
        if spread.is_of_many:
            values = dict(zip(spread.names, spread.mean.tolist(), strict=True))
            best = linearised_at(everyone, best.physics.with_values(**values))
        steps.finish()
        chosen, refused = [*effects_shown.accepted, *shown], [*effects_shown.refused, *absent]
        return _result(everyone, best, minima, spread, estimates, chosen, refused)


@dataclass
class _Steps:
    """Steps of a progress bar whose number is known approximately."""

    progress: Progress
    total: int
    done: int = 0

    def advance(self) -> None:
        """One more step, but never the last."""
        self.done = min(self.done + 1, self.total - 1)
        self.progress(self.done, self.total)

    def finish(self) -> None:
        """All steps."""
        self.progress(self.total, self.total)


def _result(
    data: DataSet,
    point: Linearisation,
    minima: tuple[Minimum, ...],
    spread: Spread,
    estimates: dict[str, FlightEstimate],
    chosen: list[Effect],
    refused: list[Effect],
) -> JointFit:
    residuals = left_out_residuals(data, point)
    moved = [data.residuals(point.physics, changes) for changes in drawn_perturbations(data.entries)]
    chi, scatter = _scatter(data, point, moved)
    throws = tuple(
        PredictedThrow(
            entry.name,
            int(entry.track.frame[entry.rows[0]]),
            len(entry.release.rows),
            len(entry.rows),
            float(np.linalg.norm(off[:, :3], axis=1).mean()),
            float(np.linalg.norm(off[:, 3:], axis=1).mean() / data.arm_m),
            None if not np.isfinite(own) else float(own),
        )
        for entry, off, own in zip(data.entries, residuals, chi, strict=True)
    )
    messages = _messages(data, throws, chosen, scatter, spread)
    parameters = _parameters(point.physics, spread, estimates)
    return JointFit(
        physics=point.physics,
        parameters=parameters,
        chosen=tuple(chosen),
        considered=tuple(refused),
        throws=throws,
        chi_scatter=scatter,
        messages=messages,
        minima=minima,
        covariance=_covariance(spread, estimates),
        misfit=_misfit(data, point, residuals, moved),
    )


def _parameters(physics: Physics, spread: Spread, estimates: dict[str, FlightEstimate]) -> dict[str, Parameter]:
    """Values with intervals: from halves of the throws, and from the flights for what these decide."""
    half_widths = dict(zip(spread.names, spread.half_widths(INTERVAL_LEVEL).tolist(), strict=True))
    for effect, estimate in estimates.items():
        half_widths.update(zip(EFFECTS[effect], estimate.half_widths.tolist(), strict=True))
    found = {}
    for name, value in physics.values.items():
        least, most = physics.bounds(name)
        at_bound = min(abs(value - least), abs(value - most)) < _BOUND_TOLERANCE
        low, high = max(value - half_widths[name], least), min(value + half_widths[name], most)
        found[name] = Parameter(value, low, high, INTERVAL_LEVEL, True, bool(at_bound))
    return found


def _covariance(spread: Spread, estimates: dict[str, FlightEstimate]) -> ParameterCovariance:
    """Blocks of what impacts and what flights decide."""
    names = [*spread.names, *(name for effect in estimates for name in EFFECTS[effect])]
    return ParameterCovariance(tuple(names), block_diag(spread.covariance, *(e.covariance for e in estimates.values())))


def _misfit(data: DataSet, point: Linearisation, residuals: list[Array], moved: list[list[Array]]) -> Misfit:
    """How far throws are off that were left out, less what the errors of their release states explain."""
    since = np.concatenate([entry.times_s - entry.release.fair_state.time_s for entry in data.entries])
    order, squares = np.argsort(since, kind="stable"), np.empty((len(since), 2))
    for k, part in enumerate((slice(0, 3), slice(3, 6))):
        off = [(own[:, part] ** 2).mean(1) for own in residuals]
        drawn = [
            np.mean([(one[:, part] - own[:, part]) ** 2 for one in ones], axis=0).mean(1)
            for own, ones in zip(point.residuals, zip(*moved, strict=True), strict=True)
        ]
        squares[:, k] = np.concatenate(off) - np.concatenate(drawn)
    parts = [part for part in np.array_split(order, _MISFIT_TIMES) if len(part)]
    means = np.sqrt(np.maximum([squares[part].mean(0) for part in parts], 0.0))
    return Misfit(np.array([since[part].mean() for part in parts]), means[:, 0], means[:, 1] / data.arm_m)


def _scatter(data: DataSet, point: Linearisation, moved: list[list[Array]]) -> tuple[Array, float | None]:
    """χ from each throw alone (NaN without information), and its scatter beyond the errors of the release states, whose draws
    leave the residuals `moved`."""
    which = point.physics.free.index("chi")
    count = len(data.entries)
    own, noise = np.full(count, np.nan), np.full(count, np.nan)
    for k, entry in enumerate(data.entries):
        slope = point.slopes[k][: entry.early, :, which]
        weight = 1.0 / (data.slack[k][: entry.early] ** 2)[:, None]
        information = float((weight * slope**2).sum())
        if information <= 0.0:
            continue
        own[k] = float((weight * slope * point.residuals[k][: entry.early]).sum()) / information
        changes = [(residuals[k] - point.residuals[k])[: entry.early] for residuals in moved]
        errors = [float((weight * slope * change).sum()) / information for change in changes]
        noise[k] = float(np.mean(np.square(errors)))
    step, known = step_of(point.physics, "chi"), np.isfinite(own)
    values = point.physics.values["chi"] + step * own
    if known.sum() < _MIN_FOR_SCATTER:
        return values, None
    deviation = float(np.median(np.abs(own[known] - np.median(own[known]))))
    total = (_NORMAL_MAD * deviation * step) ** 2
    return values, float(np.sqrt(max(0.0, total - step**2 * float(np.median(noise[known])))))


def _messages(
    data: DataSet,
    throws: Sequence[PredictedThrow],
    chosen: Sequence[Effect],
    scatter: float | None,
    spread: Spread,
) -> tuple[str, ...]:
    position = float(np.mean([throw.position_error_m for throw in throws]))
    turned = float(np.degrees(np.mean([throw.rotation_error_rad for throw in throws])))
    messages = [
        f"Throws predicted with parameters fitted to the other throws are off by {100 * position / data.die.solid.edge_m:.3g} % "
        f"of the edge and {turned:.3g} degrees: means over throws and over the frames after the first bounce.",
        "Effects in the model: " + (", ".join(effect.name for effect in chosen) or "none beyond the paper's law") + ".",
    ]
    if scatter is not None:
        messages.append(f"chi scatters by {scatter:.2g} from throw to throw, beyond the errors of the frames.")
    for one, other, correlation in spread.trade_offs(_CORRELATED):
        messages.append(
            f"{one} and {other} trade against each other: their errors have a correlation of {correlation:.2f}."
        )
    return tuple(messages)
