"""Figures state units, keep their colours, and draw the values that they are given."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import replay_records as made
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from diethrow.fitting.predict.sequential import Estimate
from diethrow.replay.elements.colours import MEASURED, SIMULATED, hex_colour
from diethrow.replay.elements.record import ReportDetails, motions_of, residuals
from diethrow.replay.figures import throw_plots
from diethrow.replay.figures.clip_frames import COLUMNS, bounce_strip, edges_on_frame, rows_of_strip, stroboscope
from diethrow.replay.pages.captioned_figures import STATE_NAMES, fit_figures, report_figures, write_figures


def axes() -> Axes:
    return Figure().subplots()


def heights(ax: Axes, label: str) -> Axes:
    track = made.track()
    return throw_plots.corner_heights(
        ax, made.die().solid, track.time_s, track.position_m, track.quaternion, made.throw().impacts, label=label
    )


def drawn() -> list[Axes]:
    rest, impacts = residuals(made.track(), made.track(1e-5)), made.throw().impacts
    record = made.record()
    clip_figures = record.clip, made.camera(), made.die().solid, motions_of(record)
    assert record.clip is not None
    return [
        heights(axes(), "measured"),
        throw_plots.position_residuals(axes(), rest, impacts),
        throw_plots.angle_residuals(axes(), rest, impacts),
        throw_plots.position_sigmas(axes(), rest, impacts),
        throw_plots.turn_sigmas(axes(), rest, impacts),
        throw_plots.throw_heights(axes(), made.die().solid, made.throw()),
        throw_plots.correlations(axes(), 1e-8 * np.eye(12), STATE_NAMES),
        throw_plots.landing_odds(axes(), {1: 0.7, 2: 0.3}),
        throw_plots.odds_over_time(axes(), estimates(), impacts),
        stroboscope(axes(), *clip_figures),
        bounce_strip(axes(), *clip_figures, impacts),
        throw_plots.restitution(axes(), impacts, made.fit().parameters["chi"]),
        edges_on_frame(axes(), record.clip, made.camera(), made.die().solid, motions_of(record), made.FIRST_FRAME + 10),
    ]


def estimates() -> tuple[Estimate, ...]:
    chi = made.fit().parameters["chi"]
    return Estimate(1, 0.03, chi, {1: 0.6, 2: 0.4}), Estimate(2, 0.04, chi, {1: 1.0, 2: 0.0})


def test_every_axis_states_its_unit() -> None:
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
    ax = throw_plots.corner_heights(axes(), made.die().solid, times, positions, quaternions)
    lowest = min(line.get_ydata()[0] for line in ax.lines[: len(made.die().solid.vertices)])
    # Rounding of a distance of 14 mm.
    assert lowest == pytest.approx(0.0, abs=1e-12)


def test_a_gap_in_the_track_is_a_gap_in_the_plot() -> None:
    track = made.track()
    line = heights(axes(), "measured").lines[0]
    np.testing.assert_array_equal(np.isnan(np.asarray(line.get_ydata(), float)), ~track.tracked)


def test_a_frame_outside_the_clip_is_refused() -> None:
    record = made.record()
    assert record.clip is not None
    with pytest.raises(IndexError, match=r"frame 0.* 7 to 66"):
        edges_on_frame(axes(), record.clip, made.camera(), made.die().solid, motions_of(record), 0)


def test_residuals_in_sigmas_are_the_residuals_over_their_standard_errors() -> None:
    moved_m, sigma_m = 3e-5, 1e-5  # sigma as in the made track
    ax = throw_plots.position_sigmas(axes(), residuals(made.track(moved_m), made.track()))
    x, y, z = (np.asarray(line.get_ydata(), float) for line in ax.lines[:3])
    np.testing.assert_allclose(x, moved_m / sigma_m, rtol=1e-9)
    np.testing.assert_allclose([y, z], 0.0, atol=1e-9)


def test_correlations_are_those_of_the_covariance() -> None:
    sigmas = np.array([1e-6, 2.0, 30.0])
    wanted = np.array([[1.0, 0.5, -0.25], [0.5, 1.0, 0.0], [-0.25, 0.0, 1.0]])
    ax = throw_plots.correlations(axes(), wanted * np.outer(sigmas, sigmas), ("a", "b", "c"))
    np.testing.assert_allclose(np.asarray(ax.images[0].get_array()), wanted, atol=1e-12)
    assert {text.get_text() for text in ax.texts} == {"50", "−25", "0"}


def test_the_multiple_exposure_shows_the_grey_levels_of_each_frame() -> None:
    """Every exposure has the grey level of its own frame, later ones in front, over the median of all of them."""
    record = made.record()
    clip = record.clip
    assert clip is not None
    for k in range(len(clip)):
        clip.array[k] = k + 1  # type: ignore[attr-defined]
    ax = stroboscope(axes(), clip, made.camera(), made.die().solid, motions_of(record))
    (shown,) = ax.images
    picture = np.asarray(shown.get_array())
    assert picture.shape == (clip.height_px, clip.width_px)
    motion = motions_of(record)[0]
    exposed = [k for k in np.unique(picture).tolist() if k - 1 + clip.first_frame in motion.frame]
    assert len(exposed) > 2
    assert np.isin(picture[0, 0], [np.median(exposed), int(np.median(exposed) + 0.5)])
    for level in (exposed[0], exposed[-1]):
        row = motion.frame.tolist().index(level - 1 + clip.first_frame)
        x, y = np.rint(made.camera().project(motion.position_m[row : row + 1])[0]).astype(int)
        assert level <= picture[y, x] <= exposed[-1]


def test_a_later_die_covers_the_edges_of_earlier_ones() -> None:
    """No edge of an exposure lies within the cut-out of a later one: its pixel has a grey level up to its own."""
    record = made.record()
    clip = record.clip
    assert clip is not None
    for k in range(len(clip)):
        clip.array[k] = 2 * k + 2  # type: ignore[attr-defined]
    whole = stroboscope(axes(), clip, made.camera(), made.die().solid, motions_of(record)[:1])
    last = motions_of(record)[0]
    picture, (line,) = np.asarray(whole.images[0].get_array()), whole.lines
    x, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
    assert np.isnan(x).any()
    known = np.isfinite(x) & (x >= 0) & (x <= clip.width_px - 1) & (y >= 0) & (y <= clip.height_px - 1)
    # The lines begin with those of the last exposure, which nothing covers.
    newest = 2 * (int(last.frame[-1]) - clip.first_frame) + 2
    levels = picture[np.rint(y[known]).astype(int), np.rint(x[known]).astype(int)]
    end_of_newest = int(np.flatnonzero(levels != newest)[0])
    assert end_of_newest > 10
    assert (levels[end_of_newest:] == newest).sum() == 0


def test_a_strip_has_the_frame_nearest_to_the_bounce_in_its_middle() -> None:
    record = made.record()
    assert record.clip is not None
    impacts = made.throw().impacts
    ((row, frames),) = rows_of_strip(record.clip, made.camera(), made.die().solid, motions_of(record)[0], impacts)
    assert row == [0]
    assert len(frames) == COLUMNS
    places = [k for k, frame in enumerate(frames) if frame is not None]
    known = [frame for frame in frames if frame is not None]
    assert abs(known[places.index(COLUMNS // 2)] / made.FPS - made.IMPACT_S) <= 0.5 / made.FPS
    steps = {(b - a) / (n - m) for (m, a), (n, b) in itertools.pairwise(zip(places, known, strict=True))}
    assert len(steps) == 1, "the frames of a row are not evenly spaced"


def test_impacts_within_three_frames_share_a_row() -> None:
    record, impact = made.record(), made.throw().impacts[0]
    assert record.clip is not None
    later = replace(impact, time_s=impact.time_s + 2.0 / made.FPS)
    far = replace(impact, time_s=impact.time_s + 8.0 / made.FPS)
    rows = rows_of_strip(record.clip, made.camera(), made.die().solid, motions_of(record)[0], (impact, later, far))
    assert [row for row, _ in rows] == [[0, 1], [2]]


def test_every_figure_is_written_as_png_and_svg(tmp_path: Path) -> None:
    record = made.record(estimates=estimates(), fit=made.fit(face_odds={1: 0.9, 2: 0.1}))
    written = write_figures(tmp_path / "figures", record)
    names = [figure.name for figure in report_figures(record, ReportDetails())]
    assert len(names) >= 9
    assert [path.name for path in written] == [f"{name}.{kind}" for name in names for kind in ("png", "svg")]
    assert all(path.read_bytes().startswith((b"\x89PNG", b"<?xml")) for path in written)


def test_a_record_without_clip_and_fit_has_the_figures_of_its_poses_only() -> None:
    bare = made.record(clip=None, camera=None, fit=None, simulated=None)
    assert [figure.name for figure in report_figures(bare, ReportDetails())] == ["heights", "restitution"]


def test_correlations_include_the_free_parameters_if_the_fit_gives_them() -> None:
    fit = made.fit(covariance=1e-8 * np.eye(13))
    for given, wanted in ((fit, (*STATE_NAMES, "chi")), (made.fit(), STATE_NAMES)):
        figure = next(each for each in fit_figures(made.record(fit=given)) if each.name == "correlations")
        ax = figure.draw(axes())
        assert tuple(label.get_text() for label in ax.get_yticklabels()) == wanted
