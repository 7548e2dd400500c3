"""Figures carry units, keep their colours, and draw what they are given."""

from __future__ import annotations

import numpy as np
import pytest
import replay_records as made
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from diethrow.replay import figures
from diethrow.replay.palette import MEASURED, SIMULATED, hex_colour
from diethrow.replay.record import motions_of, residuals


def axes() -> Axes:
    return Figure().subplots()


def heights(ax: Axes, label: str) -> Axes:
    track = made.track()
    return figures.corner_heights(
        ax, made.die().solid, track.time_s, track.position_m, track.quaternion, made.throw().impacts, label=label
    )


def drawn() -> list[Axes]:
    rest, impacts = residuals(made.track(), made.track(1e-5)), made.throw().impacts
    record = made.record()
    assert record.clip is not None
    return [
        heights(axes(), "measured"),
        figures.position_residuals(axes(), rest, impacts),
        figures.angle_residuals(axes(), rest, impacts),
        figures.sigma_residuals(axes(), rest, impacts),
        figures.restitution(axes(), impacts, made.fit().parameters["chi"]),
        figures.edges_on_frame(
            axes(), record.clip, made.camera(), made.die().solid, motions_of(record), made.FIRST_FRAME + 10
        ),
    ]


def test_every_axis_carries_its_unit() -> None:
    for ax in drawn():
        for label in (ax.get_xlabel(), ax.get_ylabel()):
            assert label.endswith("]"), label


def test_measured_is_blue_dots_and_simulated_orange_lines() -> None:
    ax = heights(heights(axes(), "measured"), "simulated")
    count = len(made.die().solid.vertices)
    by_colour = {hex_colour(MEASURED): [], hex_colour(SIMULATED): []}
    for line in ax.lines:
        by_colour.get(to_hex(line.get_color()), []).append(line)
    assert len(by_colour[hex_colour(MEASURED)]) == len(by_colour[hex_colour(SIMULATED)]) == count
    assert {line.get_marker() for line in by_colour[hex_colour(MEASURED)]} == {"o"}
    assert {line.get_linestyle() for line in by_colour[hex_colour(SIMULATED)]} == {"-"}
    assert ax.get_legend_handles_labels()[1] == ["measured", "simulated"]


def test_the_lowest_corner_touches_the_table_at_the_impact() -> None:
    times = np.array([made.IMPACT_S])
    positions, quaternions = made.throw().poses(times)
    ax = figures.corner_heights(axes(), made.die().solid, times, positions, quaternions)
    lowest = min(line.get_ydata()[0] for line in ax.lines[: len(made.die().solid.vertices)])
    # Rounding of a distance of 14 mm.
    assert lowest == pytest.approx(0.0, abs=1e-12)


def test_a_gap_in_the_track_is_a_gap_in_the_figure() -> None:
    track = made.track()
    line = heights(axes(), "measured").lines[0]
    np.testing.assert_array_equal(np.isnan(np.asarray(line.get_ydata(), float)), ~track.tracked)


def test_a_frame_outside_the_clip_is_refused() -> None:
    record = made.record()
    assert record.clip is not None
    with pytest.raises(IndexError, match="frame 0: the clip has 7 to 66"):
        figures.edges_on_frame(axes(), record.clip, made.camera(), made.die().solid, motions_of(record), 0)
