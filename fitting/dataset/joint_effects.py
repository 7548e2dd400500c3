"""Effects that throws share, accepted if they predict throws better that are left out of the fit.

Centre of mass and clock are decided by the flights before the first bounce (`flight_evidence`) and held. The effects of an
impact are added to the paper's law one at a time (`throw.effects` does the same for one throw). The throws are divided
into five folds. Each is predicted with parameters from the other folds: one step of the same minimisation from the common
fit, by the normal equations of those throws. The effect that lowers the mean cost most is accepted if, compared throw by
throw, it does so by more than Student's t allows by chance for one of all effects on trial (Bonferroni). One that raises the
cost by as much is not tried again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtri, stdtrit

from ..results import Effect
from ..throw import Physics
from .data_set import DataSet, data_set_of
from .flight_evidence import FLIGHT_EFFECTS
from .minimisation import Linearisation, left_out_residuals, minimised

Array = NDArray[np.float64]

IMPACT_EFFECTS: dict[str, tuple[str, ...]] = {
    "friction": ("mu",),
    "rounded corners": ("corner_radius_m",),
    "inertia": ("inertia_kg_m2",),
    "fading restitution": ("chi_fade_s_per_m",),
    "fading friction": ("mu_fade_s_per_m",),
}
"""Effects that impacts decide, and their parameters."""

EFFECTS: dict[str, tuple[str, ...]] = {**IMPACT_EFFECTS, **FLIGHT_EFFECTS}
"""Effects on trial and their parameters."""

_REQUIRED = {"fading friction": "mu"}
"""Parameters without which an effect does nothing."""

FIRST_CHI = (0.2, 0.35, 0.5, 0.65, 0.8, 0.95)
"""χ from which fits may start, so that no start is asked for."""

_FIRST_MU = (0.1, 0.2, 0.4)
"""The same of friction."""

_FIRST_RADII = (0.02, 0.08, 0.2)
"""The same of corner radii, in inscribed radii."""

_FIRST_FADES_S_PER_M = (0.1, 1.0)
"""The same of fading restitution and friction."""

START_THROWS = 8
"""Throws by which such starts are compared."""

_FALSE_EFFECTS = 0.05
"""Probability that any effect is accepted which no throw has."""


def least_evidence(on_trial: int, throws: int) -> Callable[[int], float]:
    """Units of log-likelihood that k parameters from flights must have, of `on_trial` effects.

    Their covariance is from `throws` throws, so that the law is Hotelling's."""
    tail = _FALSE_EFFECTS / on_trial

    def least(k: int) -> float:
        if throws <= k + 1:
            return 0.5 * float(chdtri(k, tail))
        return 0.5 * k * (throws - 1) / (throws - k) * float(fdtri(k, throws - k, 1.0 - tail))

    return least


@dataclass(frozen=True, eq=False)
class Round:
    """One choice among effects."""

    before: Array
    """(throws,) cost of each left-out throw without any of them."""
    physics: Physics
    """Without any of them."""
    trials: dict[str, tuple[Physics, Array]]
    """Physics and costs of the left-out throws with each."""


@dataclass(frozen=True, eq=False)
class ChosenEffects:
    """The effects that the impacts of a data set show."""

    point: Linearisation
    """The fit with them."""
    accepted: list[Effect]
    refused: list[Effect]
    rounds: list[Round]
    """The choices that led to it."""
    on_trial: int
    """Number of effects."""

    def resampled(self, draws: int, seed: int = 0) -> list[Physics]:
        """The fits that the same choices lead to for samples of the throws, drawn with replacement: where chance decides between
        effects, these differ. A sample that prefers an effect which was not followed further ends there."""
        rng, found = np.random.default_rng(seed), []
        count = len(self.rounds[0].before) if self.rounds else 0
        for _ in range(draws):
            which, physics = rng.integers(0, count, count), self.point.physics
            for one, accepted in zip(self.rounds, [*(e.name for e in self.accepted), None], strict=False):
                gains = {effect: (one.before - costs)[which] for effect, (_, costs) in one.trials.items()}
                best = _best_effect(gains, self.on_trial)
                if best is None:
                    physics = one.physics
                    break
                if best != accepted:
                    physics = one.trials[best][0]
                    break
            found.append(physics)
        return found


def with_effects(
    data: DataSet, point: Linearisation, effects: Sequence[str], on_trial: Callable[[], None]
) -> ChosenEffects:
    """Effects added while they are accepted, the one that lowers the cost most first.

    `effects` are of impacts. `on_trial` is called after every trial. What throws of this die cannot have is not tried.
    """
    accepted: list[Effect] = []
    left = [effect for effect in effects if point.physics.can_be_thrown_with(effect)]
    refused: dict[str, Effect] = {}
    rounds: list[Round] = []
    while left:
        # How errors of the release state grow depends on the law: the slack is computed anew.
        data = data_set_of(data.entries, point.physics, data.pool)
        point = minimised(data, point.physics)
        before = data.costs(left_out_residuals(data, point))
        trials: dict[str, tuple[Linearisation, Array]] = {}
        for effect in left:
            if _REQUIRED.get(effect, "chi") not in point.physics.values:
                refused[effect] = Effect(
                    effect, None, f"Not tried: the model has no {_REQUIRED[effect]} that could fade."
                )
                continue
            wider = _with_one_more(data, point, effect)
            gains = before - data.costs(left_out_residuals(data, wider))
            on_trial()
            trials[effect] = (wider, gains)
            refused[effect] = _refusal(effect, gains, before)
        best = _best_effect({effect: gains for effect, (_, gains) in trials.items()}, len(effects))
        if best is not None:
            # With one more parameter a descent may have found what the plainer model had not: only the rest is a gain.
            plainer = minimised(data, _without(trials[best][0].physics, best))
            if plainer.cost < point.cost:
                other = data.costs(left_out_residuals(data, plainer))
                trials = {effect: (wider, gains + other - before) for effect, (wider, gains) in trials.items()}
                point, before = plainer, other
                refused |= {effect: _refusal(effect, gains, before) for effect, (_, gains) in trials.items()}
                best = _best_effect({effect: gains for effect, (_, gains) in trials.items()}, len(effects))
        costs = {effect: (wider.physics, before - gains) for effect, (wider, gains) in trials.items()}
        rounds.append(Round(before, point.physics, costs))
        if best is None:
            break
        point = trials[best][0]
        accepted.append(Effect(best, _evidence(trials[best][1]), None))
        worse = [e for e, (_, gains) in trials.items() if gains.mean() < -_required_gain(gains, len(effects))]
        left = [effect for effect in left if effect != best and effect not in worse]
    names = {effect.name for effect in accepted}
    return ChosenEffects(
        point, accepted, [refused[e] for e in effects if e in refused and e not in names], rounds, len(effects)
    )


def _without(physics: Physics, effect: str) -> Physics:
    """The same values without an effect."""
    return replace(physics, values={n: value for n, value in physics.values.items() if n not in EFFECTS[effect]})


def _best_effect(gains: dict[str, Array], on_trial: int) -> str | None:
    """The effect with the largest mean gain of those that are more than chance; None if none is."""
    better = [effect for effect, gain in gains.items() if gain.mean() > _required_gain(gain, on_trial)]
    return max(better, key=lambda effect: float(gains[effect].mean()), default=None)


def _with_one_more(data: DataSet, point: Linearisation, effect: str) -> Linearisation:
    """The fit with one more effect, from the best of a few starts."""
    physics = point.physics.with_values(**{name: point.physics.neutral(name) for name in EFFECTS[effect]})
    starts = _starts(physics, effect)
    best = min(starts, key=data.subset(START_THROWS).mean_cost) if len(starts) > 1 else starts[0]
    return minimised(data, best)


def _starts(physics: Physics, effect: str) -> list[Physics]:
    if effect == "friction":
        return [physics.with_values(mu=mu, chi=chi) for mu in _FIRST_MU for chi in FIRST_CHI[:-1]]
    if effect == "rounded corners":
        return [physics.with_values(corner_radius_m=part * physics.die.solid.inradius) for part in _FIRST_RADII]
    if effect in ("fading restitution", "fading friction"):
        return [physics.with_values(**{EFFECTS[effect][0]: fade}) for fade in _FIRST_FADES_S_PER_M]
    return [physics]


def _required_gain(gains: Array, on_trial: int) -> float:
    """The mean that gains (throws,) of one of the effects on trial exceed by chance with the odds `_FALSE_EFFECTS`."""
    sigmas = stdtrit(len(gains) - 1, 1.0 - _FALSE_EFFECTS / on_trial)
    return float(sigmas * gains.std(ddof=1) / np.sqrt(len(gains)))


def _evidence(gains: Array) -> float:
    """Units of log-likelihood by which left-out throws are predicted better, for a normally distributed mean gain."""
    error = float(gains.std(ddof=1)) / np.sqrt(len(gains))
    return 0.5 * (float(gains.mean()) / max(error, 1e-300)) ** 2 * float(np.sign(gains.mean()))


def _refusal(effect: str, gains: Array, before: Array) -> Effect:
    share, error = gains.mean() / before.mean(), gains.std(ddof=1) / np.sqrt(len(gains)) / before.mean()
    if gains.mean() <= 0.0:
        why = f"It increases the prediction error of throws left out of the fit, by {-100 * share:.2g} %."
    else:
        why = (
            f"It reduces the prediction error of throws left out of the fit by {100 * share:.2g} %, with a standard error "
            f"of {100 * error:.2g} %: no more than chance."
        )
    return Effect(effect, _evidence(gains), why)
