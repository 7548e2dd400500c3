"""Covariances of predicted poses: from the release state, from the parameters, and from what the law misses.

State and parameters are drawn from their covariances, and each draw is simulated. The mean square of the poses about the
prediction is their part. What no law describes is measured on throws that a joint fit left out (`Misfit`), and added.
Where draws diverge (one tips over another edge) no covariance describes them; the mean square then says how far off they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import rotation_between
from ...tracking.covariance import covariance_root
from ...tracking.flights import perturbed
from ...tracking.track import Track
from ..results import Misfit, Parameter, ParameterCovariance
from ..throw import Physics
from .prediction import drawn_physics, simulated_poses
from .release_state import ReleaseState

Array = NDArray[np.float64]

POSE_DRAWS = 40
"""Draws from which a covariance is estimated: each variance to a fifth of itself."""


def with_covariances(
    predicted: Track,
    physics: Physics,
    release: ReleaseState,
    parameters: dict[str, Parameter],
    covariance: ParameterCovariance | None,
    misfit: Misfit | None,
    *,
    draws: int = POSE_DRAWS,
    seed: int = 0,
) -> Track:
    """A predicted track with the covariance (6, 6) of each pose after the release state: position [m], then rotation vector
    [rad], world axes. Without a `misfit` they leave out what the law misses; without a `covariance` each parameter is drawn
    from its interval alone. Rows up to the release state have none."""
    later = np.flatnonzero(predicted.tracked & (predicted.time_s > release.state.time_s))
    if not len(later):
        return predicted
    rng, root = np.random.default_rng(seed), covariance_root(release.covariance)
    times = predicted.time_s[later]
    squares = np.zeros((len(later), 6, 6))
    for _ in range(draws):
        other = drawn_physics(physics, parameters, covariance, rng)
        start = perturbed(release.of_die(other.body).state, root @ rng.standard_normal(12))
        positions, quaternions = simulated_poses(other, start, times)
        errors = np.hstack(
            [
                positions - predicted.position_m[later],
                rotation_between(predicted.quaternion[later], quaternions),
            ]
        )
        # A draw that never stops bouncing has no pose, and says nothing of the others.
        errors = np.where(np.isfinite(errors).all(1, keepdims=True), errors, 0.0)
        squares += np.einsum("ni,nj->nij", errors, errors) / draws
    if misfit is not None:
        squares += misfit.covariances(times - release.state.time_s)
    covariances = predicted.covariance.copy()
    covariances[later] = squares
    return replace(predicted, covariance=covariances)
