"""Shutters: every row is exposed at its own instant, for its own time."""

from __future__ import annotations

import numpy as np
import pytest

from diethrow.replay.render.shutter import MAX_STEP_PX, Shutter, instants_of, row_times

ROWS = 96
SHUTTERS = [
    Shutter(1e-3, 3e-3),
    Shutter(4e-3, 1e-3),
    Shutter(1e-6, 3e-3),  # an exposure without motion blur
    Shutter(3.3e-4, 2.9e-3),
]


@pytest.mark.parametrize("shutter", SHUTTERS)
@pytest.mark.parametrize("moved_px", [0.0, 3.0, 40.0])
@pytest.mark.parametrize("fewest", [1, 7])
def test_rows_of_a_rolling_shutter_are_at_their_instants(shutter: Shutter, moved_px: float, fewest: int) -> None:
    instants = instants_of(0.25, shutter, ROWS, moved_px, fewest)
    assert instants.row_shares is not None
    assert instants.row_shares.sum(1) == pytest.approx(1.0, abs=1e-12)
    seen_s = instants.row_shares @ instants.times_s
    assert seen_s == pytest.approx(0.25 + row_times(shutter.readout_s, ROWS), abs=1e-12)
    assert seen_s[-1] - seen_s[0] == pytest.approx(shutter.readout_s, abs=1e-12)
    assert ((instants.row_shares > 1e-12).sum(1) >= fewest).all()


@pytest.mark.parametrize("shutter", SHUTTERS)
def test_a_row_sees_its_exposure_and_no_more(shutter: Shutter) -> None:
    moved_px = 40.0
    instants = instants_of(0.0, shutter, ROWS, moved_px)
    assert instants.row_shares is not None
    step_s = np.diff(instants.times_s)[0]
    assert step_s * moved_px / shutter.span_s <= MAX_STEP_PX * (1 + 1e-9)
    away_s = np.abs(instants.times_s - row_times(shutter.readout_s, ROWS)[:, None])
    assert away_s[instants.row_shares > 1e-12].max() <= max(shutter.exposure_s, step_s) / 2 + step_s
    # The spread of a box of this length, to the square of a step.
    spread_s2 = (instants.row_shares * away_s**2).sum(1)
    assert spread_s2 == pytest.approx(shutter.exposure_s**2 / 12, abs=step_s**2)


def test_all_rows_of_a_global_shutter_see_the_same_invisible_steps() -> None:
    instants = instants_of(1.0, Shutter(2e-3), ROWS, moved_px=30.0)
    assert instants.row_shares is None
    assert len(instants.times_s) == 75
    assert instants.times_s.mean() == pytest.approx(1.0)
    assert np.ptp(instants.times_s) == pytest.approx(2e-3 * 74 / 75)
    assert len(instants_of(1.0, Shutter(2e-3), ROWS, moved_px=0.0).times_s) == 1


@pytest.mark.parametrize(
    ("exposure_s", "readout_s", "wanted"),
    [
        (0.0, 0.0, "exposure_s = 0.0: wanted a finite number"),
        (1e-3, -1e-3, "readout_s = -0.001: wanted 0 for a global"),
    ],
)
def test_impossible_shutters_are_refused(exposure_s: float, readout_s: float, wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        Shutter(exposure_s, readout_s)
