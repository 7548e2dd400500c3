"""The values of a fit: parameters with intervals, initial conditions with covariance, and what was said on the way.

What cannot be had is None, with a sentence in `Fit.messages` that says why: a number that the data do not carry is
never made up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model.laws import Restitution
from ..model.throw import State, Throw

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """One parameter of the model and its interval."""

    value: float | None
    """In the unit of the parameter's name; None when the data do not determine it."""
    low: float | None
    high: float | None
    """Bounds of the interval; None when it cannot be had."""
    level: float | None
    """Coverage of the interval, such as 0.95; None without an interval."""
    free: bool
    """True when the data moved it, False when it was held."""
    at_bound: bool
    """True when the best value lies on a bound of what the law allows; the interval is then one-sided."""


@dataclass(frozen=True)
class Effect:
    """Something that the scene may need beyond the plainest model, and what the data say of it."""

    name: str
    evidence: float | None
    """By how many units of log-likelihood the effect improves the fit; None when it was not tried."""
    why_not: str | None
    """Why it was not chosen, as a sentence; None for an effect that was chosen."""


@dataclass(frozen=True, eq=False)
class Fit:
    """What the track says about the model."""

    parameters: dict[str, Parameter]
    """By name; `chi` always."""
    initial: State | None
    """The fitted state at the beginning of the first flight: on the true clock and in true metres where the fit found
    that the track has others (`clock_scale`, `length_scale`)."""
    initial_covariance: Array | None
    """(12, 12) of `initial`: position [m], rotation vector [rad], velocity [m/s], angular velocity [rad/s], world axes,
    R_true = exp(δ) R; scaled up by what the residuals show of the frames' true errors."""
    chosen: tuple[str, ...]
    """Names of the effects in the model that was fitted."""
    considered: tuple[Effect, ...]
    """The effects that were left out."""
    bounces_fitted: int
    """Bounces of the measured throw that the model runs through and explains."""
    residual_rms: float | None
    """Root mean square of the whitened residuals, 1 when the model and the frames' covariances are both right.
    When no bounce is explained: of the model's best attempt at the first bounce."""
    landed_face: int | None
    """Number (1, 2, …) of the face that the die comes to rest on; None when this is not decided."""
    face_odds: dict[int, float] | None
    """Share of landings on each face when throws drawn from the fit are simulated on to rest; None if not computed."""
    messages: tuple[str, ...]
    """One sentence each: what a careful reader of the numbers should know."""
    throw: Throw | None
    """The model's throw, from `initial` through every impact that the fit reached, on the track's clock and in its metres."""
    restitution: Restitution = "stronge"
    """What χ means where something rubs; see `model.impacts.CoulombImpact`."""
    covariance: Array | None = None
    """(12 + k, 12 + k) of `initial` and, behind it, of the k free parameters in the order of `parameters`; None where no
    such fit was made."""
