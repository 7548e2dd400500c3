"""Whether the interval of a fitted parameter contains the truth."""

from __future__ import annotations

import numpy as np
import pytest

from diethrow.fitting.dataset.joint_fit import JointFit
from diethrow.fitting.results import Fit


def assert_inside(fit: Fit | JointFit, name: str, truth: float, within: float = np.inf) -> None:
    """A parameter is near the truth, and twice its 95 % interval contains it: one in ten thousand does not."""
    found = fit.parameters[name]
    assert found.value == pytest.approx(truth, abs=within)
    assert found.low is not None
    assert found.high is not None
    margin = 0.5 * (found.high - found.low)
    assert found.low - margin <= truth <= found.high + margin
