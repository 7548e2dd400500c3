"""What a camera does with its frames, and faults of their order."""

from __future__ import annotations

import numpy as np
import pytest

from diethrow.replay.render.camera_processing import (
    COLOUR_FILTERS,
    Processing,
    Processor,
    filtered,
    gains,
    sharpened,
    shifted,
    shifts_px,
)
from diethrow.replay.render.frame_faults import FROZEN_FRAMES, FrameFaults, shown_pictures

STILL = np.zeros(2)


def test_a_camera_without_processing_changes_nothing() -> None:
    levels = np.random.default_rng(1).uniform(0.0, 255.0, (20, 30))
    processor = Processor(Processing(), 1.0)
    for _ in range(2):
        assert (processor.levels(levels, STILL) == levels).all()
    assert (filtered(levels, Processing()) == levels).all()
    assert (gains(Processing(), 5) == 1.0).all()
    assert (shifts_px(Processing(), 5, 1) == 0.0).all()


def test_the_gain_drifts_by_its_share_on_both_sides_of_the_middle() -> None:
    gain = gains(Processing(gain_drift=0.2), 101)
    assert gain[[0, 50, 100]] == pytest.approx([1 / 1.2, 1.0, 1.2])
    assert (np.diff(gain) > 0).all()


def test_a_mosaic_has_the_filters_of_its_cells() -> None:
    light = filtered(np.ones((5, 7)), Processing(bayer=True))
    for row in range(5):
        for column in range(7):
            assert light[row, column] == COLOUR_FILTERS[row % 2, column % 2]


def test_sharpening_gives_edges_halos_and_leaves_flat_areas() -> None:
    edge = np.full((40, 40), 50.0)
    edge[:, 20:] = 150.0
    sharp = sharpened(edge, 1.0)
    assert sharp[20, 20:24].max() > 165.0
    assert sharp[20, 16:20].min() < 35.0
    assert sharp[:, [0, -1]] == pytest.approx(edge[:, [0, -1]])
    assert sharp.mean() == pytest.approx(edge.mean())


def test_noise_reduction_halves_the_noise_and_does_not_delay_a_bright_object() -> None:
    rng = np.random.default_rng(1)
    processor = Processor(Processing(denoising=1.0), 2.0)
    for _ in range(12):
        frame = processor.levels(100.0 + rng.normal(0.0, 2.0, (60, 60)), STILL)
    assert 0.7 < frame.std() < 1.3
    bright = np.full((60, 60), 100.0)
    bright[20:40, 20:40] = 200.0
    assert processor.levels(bright, STILL)[22:38, 22:38] == pytest.approx(200.0, abs=1.0)


def test_a_stabiliser_moves_the_picture_to_the_right_and_down() -> None:
    levels = np.random.default_rng(1).uniform(0.0, 255.0, (20, 30))
    assert shifted(levels, np.array([3.0, 2.0]))[2:, 3:] == pytest.approx(levels[:-2, :-3])
    walk = shifts_px(Processing(shake_px=1.5), 4000, 1)
    # 4000 frames hold some 170 independent shifts: their standard deviation is known to 5 %.
    assert walk.std(0) == pytest.approx([1.5, 1.5], rel=0.2)
    assert np.abs(np.diff(walk, axis=0)).max() < 4 * 1.5 * np.sqrt(2 / 12)
    assert (walk == shifts_px(Processing(shake_px=1.5), 4000, 1)).all()


def test_missing_frames_leave_gaps_and_doubled_ones_repeat() -> None:
    missing = shown_pictures(FrameFaults(missing=0.05), 100, 1)
    assert len(missing) == 95
    assert (np.diff(missing) > 0).all()
    assert (np.diff(missing) > 1).any()
    doubled = shown_pictures(FrameFaults(doubled=0.05), 100, 1)
    assert len(doubled) == 105
    assert (np.unique(doubled) == np.arange(100)).all()
    assert (np.diff(doubled) == 0).sum() == 5


def test_a_freeze_shows_one_picture_and_then_goes_on_in_time() -> None:
    shown = shown_pictures(FrameFaults(frozen=0.01), 100, 3)
    assert len(shown) == 100
    (begin,) = np.flatnonzero(np.diff(shown) == 0)[:1]
    assert (shown[begin : begin + FROZEN_FRAMES + 1] == begin).all()
    after = begin + FROZEN_FRAMES + 1
    assert (shown[after:] == np.arange(after, 100)).all()


@pytest.mark.parametrize("fault", ["missing", "doubled", "frozen"])
def test_a_share_of_faults_is_at_least_one_and_never_at_the_beginning(fault: str) -> None:
    faults = FrameFaults(**{fault: 0.001})
    for seed in range(5):
        shown = shown_pictures(faults, 12, seed)
        assert shown.tolist() != list(range(12))
        assert shown[:2].tolist() == [0, 1]
    assert shown_pictures(FrameFaults(), 12, 1).tolist() == list(range(12))


@pytest.mark.parametrize(
    ("settings", "wanted"),
    [
        ({"gain_drift": -0.1}, "gain_drift = -0.1: wanted 0 or more"),
        ({"denoising": 2.0}, "denoising = 2.0: wanted 0 .none. to 1"),
    ],
)
def test_impossible_processing_is_refused(settings: dict[str, float], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        Processing(**settings)


def test_an_impossible_share_of_faults_is_refused() -> None:
    with pytest.raises(ValueError, match=r"missing = 0.9: wanted a share of the frames, 0 to 0.5"):
        FrameFaults(missing=0.9)
