"""The values of a fit: parameters with intervals, initial conditions with covariance, and messages.

What the data do not determine is None, with a message in `Fit.messages` that says why; no number is made up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..model.laws import Restitution
from ..model.throw import State, Throw

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """One parameter of the model and its interval."""

    value: float | None
    """In the unit of the parameter's name; None if the data do not determine it."""
    low: float | None
    high: float | None
    """Bounds of the interval; None if it cannot be had."""
    level: float | None
    """Coverage of the interval, such as 0.95; None without an interval."""
    free: bool
    """True if the data moved it, False if it was held."""
    at_bound: bool
    """True if the best value lies on a bound of what the law allows; the interval is then one-sided."""


@dataclass(frozen=True)
class Effect:
    """A departure from the plainest model, and the evidence for it."""

    name: str
    evidence: float | None
    """Units of log-likelihood by which the effect improves the fit; None if it was not tried."""
    why_not: str | None
    """Why it was refused, as a sentence; None for an effect that was accepted."""


@dataclass(frozen=True, eq=False)
class Fit:
    """The model that a track supports."""

    parameters: dict[str, Parameter]
    """By name; always with `chi`."""
    initial: State | None
    """The fitted state at the beginning of the first flight: on the true clock and in true metres if the fit found that
    those of the track differ (`clock_scale`, `length_scale`)."""
    initial_covariance: Array | None
    """(12, 12) of `initial`: position [m], rotation vector [rad], velocity [m/s], angular velocity [rad/s], world axes,
    R_true = exp(δ) R; scaled up by what the residuals show of the frames' true errors."""
    chosen: tuple[str, ...]
    """Names of the effects in the model."""
    considered: tuple[Effect, ...]
    """The effects that were refused."""
    bounces_fitted: int
    """Bounces of the measured throw that the model explains."""
    residual_rms: float | None
    """Root mean square of the whitened residuals: 1 if the model and the frames' covariances are right. If no bounce is
    explained: of the model's best attempt at the first bounce."""
    landed_face: int | None
    """Number (1, 2, …) of the face that the die comes to rest on; None if this is not decided."""
    face_odds: dict[int, float] | None
    """Share of landings on each face when throws drawn from the fit are simulated to rest; None if not computed."""
    messages: tuple[str, ...]
    """Sentences that a reader of the numbers should know."""
    throw: Throw | None
    """The model's throw, from `initial` through every fitted impact, on the track's clock and in its metres."""
    restitution: Restitution = "stronge"
    """What χ means in frictional contact; see `model.laws.CoulombImpact`."""
    covariance: Array | None = None
    """(12 + k, 12 + k) of `initial` and of the k free parameters in the order of `parameters`; None if no such fit was
    made."""
    variance_shares: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Shares of the variance of each parameter, which add up to 1: `noise` of the frames, `calibration`, `die`, `clock`, and
    `impact law`, what the residuals show beyond all of these. Empty where cameras, die and clock are exact."""
