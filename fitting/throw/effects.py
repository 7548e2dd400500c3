"""Which effects a throw shows: one at a time, each paid for by evidence.

The plainest model comes first. Every effect that is not in use is then asked what it would gain on the frames at hand
(those of the bounces explained so far and, where the model stops, of the flight that it cannot explain), by the fall of
half the cost in a fit with its parameters freed. The costs are in units of what remains unexplained with the effect:
s² τ, the variance of the residuals and the frames over which they are alike (`intervals`). An effect is chosen if

- the gain exceeds k (½ log n + log q), k its parameters, n the numbers seen, q the effects on trial: half the extended
  Bayesian information criterion (Chen & Chen, Biometrika 95, 759, 2008), whose second term pays for the choice among
  many; one effect in two hundred is then chosen by chance, and
- it predicts better: frames left out in blocks of neighbours are foretold more closely with it than without, and
- it is larger than what the calibration of a camera leaves open in any scene (`physics.LEAST_OF_CALIBRATION`).

The one that gains most is taken, the bounces are gone through again, and the others are asked anew. What a fit would
gain is first told from derivatives at the present fit, without a new one (Rao's score test); only effects that could
pay are then fitted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.throw import Throw
from ..estimation import condensed, huber, in_units_of, orthonormal
from ..free import FreeFlights, Load, load_in_flight, shakes_seen
from ..results import Effect
from .extension import best_attempt, is_explained, loss_scale, reach, starts_with, ways_of_friction, well_explained
from .physics import EFFECTS, Physics
from .shooting import Shot, linear, shoot, widened, with_physics

Array = NDArray[np.float64]

_BLOCK = 6
"""Frames that are left out together: errors of neighbours are alike."""

_FIXED = 1e-3
"""Smallest eigenvalue of 1 - H_bb at which a block can still be foretold from the others."""

_HOPEFUL = 0.3
"""Part of the price at which an effect is fitted: a gain foretold by derivatives may be short of the real one."""

_AGREED = 0.5
"""Least part of what a load of its own in every flight would gain that one load in all of them has to."""

HELD_AT_FIRST = frozenset({"table_frequency_hz", "table_phase_rad"})
"""Of a motion that the bounces show, what a fit to the first of them leaves alone."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One effect tried on the frames of a shot."""

    effect: str
    shot: Shot | None
    """With the effect; None where derivatives already said that it does not pay."""
    gain: float
    """Units of log-likelihood."""
    price: float
    """What it must gain."""
    foretold: float
    """By how many units of log-likelihood it foretells frames left out better; 0 where it was not fitted."""

    @property
    def pays(self) -> bool:
        """Whether the effect is to be taken in."""
        if self.shot is None or self.gain <= self.price or self.foretold <= 0.0:
            return False
        return self.shot.physics.is_noticeable(self.effect)

    @property
    def worth(self) -> float:
        """Gain beyond the price."""
        return self.gain - self.price

    @property
    def in_words(self) -> Effect:
        """As an entry of the result."""
        if self.pays:
            return Effect(self.effect, self.gain, None)
        if self.gain <= self.price:
            why = (
                f"It gains {self.gain:.1f} units of log-likelihood, and would have to gain {self.price:.1f} to pay for "
                f"its {_count(len(EFFECTS[self.effect]))}."
            )
        elif self.foretold <= 0.0:
            why = (
                f"It gains {self.gain:.1f} units of log-likelihood on the frames it is fitted to, but foretells frames "
                "left out no better."
            )
        else:
            assert self.shot is not None
            found = ", ".join(f"{name} {self.shot.physics.values[name]:.6g}" for name in EFFECTS[self.effect])
            why = f"It gains {self.gain:.1f} units of log-likelihood, but is no more ({found}) than calibration leaves open."
        return Effect(self.effect, self.gain, why)


def try_effects(shot: Shot, measured: Throw, free: FreeFlights) -> list[Trial]:
    """Every effect that is not in use, tried on the frames that a shot explains."""
    return [_try(shot, effect, measured, free) for effect in unused_effects(shot.physics)]


def try_effects_at_a_loss(shot: Shot, measured: Throw, free: FreeFlights) -> list[Trial]:
    """Every effect that is not in use, tried on the flight after the last that a shot explains.

    The shot's own fit to those frames is too far off for derivatives to tell anything, or for a descent to lead back
    from it; so each effect starts from where the shot was good, with little and with much of it.
    """
    attempt = best_attempt(shot, measured, free)
    if attempt is None or not attempt.vertices:
        return try_effects(shot, measured, free) if shot.vertices else []
    trials: list[Trial] = []
    for effect in unused_effects(shot.physics):
        # Once one effect explains the flight, another has to do the same, which a few frames tell.
        explained = any(trial.shot is not None and is_explained(trial.shot, free) for trial in trials)
        trials.append(_try_on(shot, attempt, effect, measured, free, patient=not explained))
    return trials


def no_longer_pays(shot: Shot, free: FreeFlights) -> str | None:
    """An effect in use without which the shot would explain its frames as well; None if all are needed.

    The first that was taken in may have stood for one that came later.
    """
    k2 = loss_scale(free)
    for effect in shot.physics.effects:
        plainer = shoot(shot.sightings, with_physics(shot, shot.physics.without_effect(effect), k2), shot.vertices, k2)
        if not _compared(plainer, shot, effect, k2).pays:
            return effect
    return None


def unused_effects(physics: Physics) -> list[str]:
    """The effects that this die on this table could show and the model does not have."""
    return [effect for effect in candidates_for(physics) if effect not in physics.effects]


def _try_on(shot: Shot, attempt: Shot, effect: str, measured: Throw, free: FreeFlights, *, patient: bool) -> Trial:
    """One effect on the frames of an attempt that failed without it."""
    k2 = loss_scale(free)
    starts = [*starts_with(effect, shot.physics, free, shot.reached, attempt.reached), shot.physics.with_effect(effect)]
    if effect == "loaded die":
        load, gain = _hopeful_load(attempt, free)
        if load is None:
            return Trial(effect, None, gain, _price(attempt, effect), 0.0)
        starts = [shot.physics.with_values(**load.values)]
    if is_unknown_motion(effect, shot.physics):
        # One bounce cannot tell three numbers: the frequency stays as all bounces have it until the fit has some of them.
        seen = shakes_seen(shot.physics.body, free, measured.impacts)
        starts = [replace(shot.physics.with_values(**values), held=HELD_AT_FIRST) for values in seen]
        patient = True  # it is in few scenes, and where it is, others may have passed for it at the first bounce
    onward = attempt.vertices[len(shot.vertices) :]
    found: list[Shot] = []
    for physics in (*starts, *(kind for start in starts for kind in start.with_other_restitutions())):
        other = reach(with_physics(shot, physics, k2), onward, attempt.reached, free, patient=patient)
        found += [] if other is None else [other]
        if other is not None and well_explained(other, free):
            break
    if not found:
        return Trial(effect, None, 0.0, _price(attempt, effect), 0.0)
    best = min(found, key=lambda other: other.mean_square)
    refitted = shoot(attempt.sightings, best, best.vertices, k2)
    return _compared(attempt, ways_of_friction(refitted, free)[0], effect, k2)


def candidates_for(physics: Physics) -> tuple[str, ...]:
    """The effects that this die on this table could show, and that can stand beside those in use."""
    return tuple(effect for effect in EFFECTS if physics.goes_with(effect))


def is_unknown_motion(effect: str, physics: Physics) -> bool:
    """Whether an effect is the motion of a table of which the scene says nothing: no derivative leads there from rest."""
    return effect == "oscillating table" and not physics.table.moves


def _try(shot: Shot, effect: str, measured: Throw, free: FreeFlights) -> Trial:
    """One effect on the frames that a shot explains."""
    k2 = loss_scale(free)
    if effect == "loaded die":
        return _try_load(shot, free)
    if is_unknown_motion(effect, shot.physics):
        return _try_motion(shot, measured, free)
    wider, residuals, jacobian = widened(shot, shot.physics.with_effect(effect), k2)
    hoped = _foreseen_gain(residuals, jacobian, wider.root)
    if hoped < _HOPEFUL * _price(shot, effect):
        return Trial(effect, None, hoped, _price(shot, effect), 0.0)
    return _compared(shot, shoot(shot.sightings, wider, shot.vertices, k2), effect, k2)


def _hopeful_load(shot: Shot, free: FreeFlights) -> tuple[Load | None, float]:
    """The centre of mass that the flights show, None where it is not worth a fit; and what it gains there. One that is another
    from flight to flight is none: a single flight that was tracked wrongly gains much by it."""
    load = load_in_flight(free)
    gain = 0.0 if load is None or load.agreed < _AGREED else load.gain
    return (load if gain >= _HOPEFUL * _price(shot, "loaded die") else None), gain


def _try_load(shot: Shot, free: FreeFlights) -> Trial:
    """The same of a loaded die, which free flights tell without the simulation of a die that is no spherical top: scenes
    with a fair die do not pay for that."""
    effect, k2 = "loaded die", loss_scale(free)
    load, gain = _hopeful_load(shot, free)
    if load is None:
        return Trial(effect, None, gain, _price(shot, effect), 0.0)
    # From where the flights see it, and from nowhere: the start that fits without it may lie far from the first.
    starts = (shot.physics.with_values(**load.values), shot.physics.with_effect(effect))
    found = [shoot(shot.sightings, with_physics(shot, start, k2), shot.vertices, k2) for start in starts]
    return _compared(shot, min(found, key=lambda s: s.cost(k2)), effect, k2)


def _try_motion(shot: Shot, measured: Throw, free: FreeFlights) -> Trial:
    """The same of a table that oscillates, from the motions that the bounces show."""
    effect, k2 = "oscillating table", loss_scale(free)
    starts = [shot.physics.with_values(**seen) for seen in shakes_seen(shot.physics.body, free, measured.impacts)]
    found = [shoot(shot.sightings, with_physics(shot, start, k2), shot.vertices, k2) for start in starts]
    if not found:
        return Trial(effect, None, 0.0, _price(shot, effect), 0.0)
    return _compared(shot, min(found, key=lambda other: other.cost(k2)), effect, k2)


def _compared(shot: Shot, wider: Shot, effect: str, k2: float) -> Trial:
    """What an effect gains on the frames that both shots are fitted to."""
    scale = _scale(wider)
    gain = 0.5 * (shot.cost(k2) - wider.cost(k2)) / scale
    # Blocks that either fit needs to stand at all are left out of the comparison.
    foretold = 0.5 * float(np.nansum(left_out_costs(shot, k2) - left_out_costs(wider, k2))) / scale
    return Trial(effect, wider, gain, _price(shot, effect), foretold)


def _price(shot: Shot, effect: str) -> float:
    """What an effect must gain on the frames of a shot."""
    count = len(unused_effects(shot.physics))
    return len(EFFECTS[effect]) * float(0.5 * np.log(shot.residuals.size) + np.log(count))


def _foreseen_gain(residuals: Array, jacobian: Array, root: Array) -> float:
    """By how much half the cost would fall if the residuals were linear in all unknowns, in units of what is left."""
    few = condensed(residuals.ravel(), in_units_of(root, jacobian.reshape(-1, jacobian.shape[2])))
    left = float(few[-1, -1] ** 2)
    fall = float((residuals**2).sum()) - left
    return 0.5 * fall / max(1.0, left / max(residuals.size - len(root), 1))


def _scale(shot: Shot) -> float:
    """s² τ of what a shot leaves."""
    variance, tau = shot.inflation
    return variance * tau


def left_out_costs(shot: Shot, k2: float) -> Array:
    """ρ summed over each block of frames, foretold by a fit without them; NaN for a block that alone fixes a direction.

    With H the hat matrix of a linear fit, the residuals of a block left out are (1 - H_bb)⁻¹ r_b (Cook & Weisberg,
    Residuals and Influence in Regression, 1982, Sec. 3.2).
    """
    residuals, jacobian = linear(shot)
    q = orthonormal(jacobian.reshape(-1, jacobian.shape[2]), shot.root).reshape(len(residuals), 6, -1)
    costs = []
    for rows in _blocks(shot):
        own = q[rows].reshape(-1, q.shape[2])
        loose = np.eye(len(own)) - own @ own.T
        if np.linalg.eigvalsh(loose)[0] < _FIXED:
            costs.append(np.nan)
            continue
        apart = np.linalg.solve(loose, residuals[rows].ravel()).reshape(-1, 6).astype(np.float64)
        kept, _ = huber(apart, np.empty((len(apart), 6, 0)), k2)
        costs.append(float((kept**2).sum()))
    return np.array(costs)


def _blocks(shot: Shot) -> list[NDArray[np.int64]]:
    """Rows of neighbouring frames of one flight, a few at a time."""
    blocks: list[NDArray[np.int64]] = []
    for k in np.unique(shot.sightings.flight):
        rows = np.flatnonzero(shot.sightings.flight == k)
        blocks.extend(np.array_split(rows, max(1, round(len(rows) / _BLOCK))))
    return blocks


def _count(parameters: int) -> str:
    return "one parameter" if parameters == 1 else f"{parameters} parameters"
