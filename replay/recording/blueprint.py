"""The layout of the viewer for one throw: the tabs Replay, Bounces, Residuals and Fit, without views that would be empty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike, NDArray

from ..elements import Residuals

Array = NDArray[np.float64]

TRAIL_FRAMES = 40
"""Length of the corner trails before the cursor."""

PLAYBACK_SPEED = 0.02
"""A throw of 0.2 s plays for ten seconds."""

FOLLOW_DISTANCE = 5.0
"""Distance of the viewpoint that follows the die, in the die's radii: the die fills half of the view, its trails the rest."""

BOUNCE_PARTS = ("impacts", "impulses")
"""Entities of each motion whose rows all remain visible up to the cursor; of labels only the last is readable."""

SCENERY = ("+ world/table/**", "+ world/camera")
"""Paths are listed one by one: a glob in the middle of a path matches nothing, without a warning."""

BACKGROUND = (24, 26, 30)
"""Of the three-dimensional views."""

MIN_RESIDUAL_SIGMAS = 2.2
"""Smallest half range of a plot of residuals in standard errors: the band of ± 2 fits in."""

TICK_STEPS = (1.0, 2.0, 3.0, 10.0)
"""Half ranges of an axis, times a power of ten: the viewer labels only such values."""


@dataclass(frozen=True, eq=False)
class RecordingContents:
    """The contents of a recording, as far as the layout depends on them."""

    motions: tuple[str, ...]
    """`measured`, `simulated`, or both."""
    fps: float
    """[Hz]."""
    eye_m: Array
    """(3,) viewpoint of the three-dimensional views."""
    target_m: Array
    """(3,) point at the centre of these views."""
    frames: tuple[int, int]
    """First and last frame with a pose: the range that is played."""
    height_mm: float
    """Height of the highest corner."""
    radius_m: float
    """Radius of the sphere through the corners of the die."""
    image_px: tuple[int, int] | None = None
    """Width and height of the video; None without one."""
    residuals: Residuals | None = None
    chi_range: tuple[float, float] | None = None
    """Range of the plot of χ; None if no χ is known."""
    odds: bool = False
    """Whether it has odds of the landing faces."""
    bounces: bool = False
    """Whether any motion has bounces."""


def blueprint(contents: RecordingContents) -> rrb.Blueprint:
    """The tabs Replay, Bounces, Residuals and Fit, as far as they have contents."""
    tabs = [_replay_tab(contents)]
    if contents.bounces:
        tabs.append(_bounces_tab())
    if contents.residuals is not None:
        tabs.append(_residuals_tab(contents.residuals))
    tabs.append(_fit_tab(contents))
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=0), *panels("frame", contents.fps, contents.frames), auto_views=False
    )


def panels(timeline: str, fps: float, played: tuple[int, int]) -> tuple[rrb.BlueprintPart, ...]:
    """Collapsed panels, and playback: paused at the beginning, slow, looping over the frames `played`."""
    return (
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline=timeline,
            fps=fps,
            playback_speed=PLAYBACK_SPEED,
            loop_mode="selection",
            time_selection=rr.encodings.AbsoluteTimeRange(*played),
            play_state="paused",
        ),
    )


# --- Replay ---


def _replay_tab(contents: RecordingContents) -> rrb.Container:
    both = len(contents.motions) == 2
    sides = [_side_view(contents, motion) for motion in contents.motions]
    overlay = [_overlay_view(contents)] if both else []
    video = [_video_view(contents.image_px)] if contents.image_px is not None else []
    if not video and not both:
        return rrb.Vertical(*sides, _heights_view(contents), row_shares=[3, 2], name="Replay")
    right = rrb.Vertical(rrb.Horizontal(*sides), _heights_view(contents), row_shares=[3, 2])
    return rrb.Horizontal(rrb.Vertical(*video, *overlay), right, column_shares=[2, 3], name="Replay")


def _side_view(contents: RecordingContents, motion: str) -> rrb.Spatial3DView:
    """The table, the camera, and one die with its bounces."""
    entities = [f"+ world/{motion}/{part}" for part in ("die/**", "trail", "impacts/**", "impulses/**")]
    return scene_view(
        motion.capitalize(), [*SCENERY, *entities], [f"world/{motion}"], contents.eye_m, contents.target_m, contents.fps
    )


def _overlay_view(contents: RecordingContents) -> rrb.Spatial3DView:
    """Both dice in one view that follows the measured one."""
    # Without the measured edges, which would hide the model's where the two agree.
    motions = {"measured": ("die", "trail", "impacts/**"), "simulated": ("die/edges",)}
    entities = [f"+ world/{motion}/{part}" for motion, parts in motions.items() for part in parts]
    towards = (contents.eye_m - contents.target_m) / np.linalg.norm(contents.eye_m - contents.target_m)
    return scene_view(
        "Overlay: measured solid, simulated edges",
        [*SCENERY, *entities],
        [f"world/{motion}" for motion in motions],
        contents.target_m + FOLLOW_DISTANCE * contents.radius_m * towards,
        contents.target_m,
        contents.fps,
        follow="world/measured/die",
    )


def scene_view(
    name: str,
    contents: list[str],
    motions: list[str],
    eye_m: Array,
    target_m: Array,
    fps: float,
    *,
    follow: str | None = None,
) -> rrb.Spatial3DView:
    """A three-dimensional view from `eye_m` on `target_m`, with the trails, impacts and impulses of `motions`.

    The viewpoint moves with the entity `follow`.
    """
    overrides = {f"{motion}/trail": _last(TRAIL_FRAMES, fps) for motion in motions}
    overrides |= {f"{motion}/{part}": _so_far() for motion in motions for part in BOUNCE_PARTS}
    return rrb.Spatial3DView(
        origin="world",
        contents=contents,
        name=name,
        overrides=overrides,
        background=rrb.Background(color=BACKGROUND),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=eye_m,
            look_target=target_m,
            eye_up=(0.0, 0.0, 1.0),
            tracking_entity=follow,
        ),
    )


def _last(frames: int, fps: float) -> rrb.VisibleTimeRanges:
    """The given number of frames up to the cursor, on either timeline."""
    nanoseconds = round(frames / fps * 1e9)
    return _ranges(
        rrb.TimeRangeBoundary.cursor_relative(seq=-frames), rrb.TimeRangeBoundary.cursor_relative(nanos=-nanoseconds)
    )


def _so_far() -> rrb.VisibleTimeRanges:
    """Everything up to the cursor, on either timeline."""
    return _ranges(rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.infinite())


def _ranges(begin_frame: rrb.TimeRangeBoundary, begin_t: rrb.TimeRangeBoundary) -> rrb.VisibleTimeRanges:
    now_frame, now_t = rrb.TimeRangeBoundary.cursor_relative(seq=0), rrb.TimeRangeBoundary.cursor_relative(nanos=0)
    return rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange("frame", start=begin_frame, end=now_frame),
            rrb.VisibleTimeRange("t", start=begin_t, end=now_t),
        ]
    )


def _video_view(image_px: tuple[int, int]) -> rrb.Spatial2DView:
    width, height = image_px
    return rrb.Spatial2DView(
        origin="world/camera/image",
        name="Camera: measured edges blue, simulated edges orange",
        visual_bounds=rrb.VisualBounds2D(x_range=(0.0, width), y_range=(0.0, height)),
    )


def _heights_view(contents: RecordingContents) -> rrb.TimeSeriesView:
    """A legend of sixteen names would hide the curves: the title replaces it."""
    legend = ", ".join(
        {"measured": "measured wide", "simulated": "simulated narrow"}[name] for name in contents.motions
    )
    name = f"Height of every corner [mm]: {legend}; vertical lines: bounces"
    return plot("plots/height", name, (-0.04 * contents.height_mm, 1.04 * contents.height_mm), legend=None)


# --- Bounces, residuals, fit ---


def _bounces_tab() -> rrb.Container:
    left = rrb.Vertical(log_view(), lanes_view(), row_shares=[3, 2])
    right = rrb.Vertical(
        plot("plots/spin", "Angular speed [rad/s]", legend=rrb.Corner2D.LeftTop), plot("plots/energy", "Energy [mJ]")
    )
    return rrb.Horizontal(left, right, column_shares=[6, 5], name="Bounces")


def log_view() -> rrb.TextLogView:
    """The event log without the columns path and level, which would take half of its width."""
    columns = rrb.TextLogColumns(text_log_columns=["Body"])
    return rrb.TextLogView(origin="events", name="Bounces, and the estimate after each", columns=columns)


def lanes_view() -> rrb.StateTimelineView:
    """Flights, held contacts, and the status of tracking."""
    return rrb.StateTimelineView(origin="phase", name="Flights and contacts")


def _residuals_tab(rest: Residuals) -> rrb.Container:
    rows = [
        rrb.Horizontal(
            plot(f"plots/residual/{what}_{unit}", f"{name} [{symbol}], with standard errors", _about_zero(values)),
            plot(
                f"plots/residual/{what}_sigmas",
                f"{name} [standard errors]; bands: ± 1 and ± 2",
                _about_zero(sigmas, MIN_RESIDUAL_SIGMAS),
            ),
        )
        for what, unit, symbol, name, values, sigmas in (
            ("position", "mm", "mm", "Position, measured minus simulated", rest.position_mm, _shares(rest, 0)),
            ("turn", "deg", "°", "Rotation from simulated to measured", rest.turn_deg, _shares(rest, 3)),
        )
    ]
    name = "All six, whitened: root mean square [standard errors]; noise alone gives 1"
    top = _about_zero(rest.sigmas, 2.0)[1]
    last = plot("plots/residual/rms_sigmas", name, (-0.05 * top, top), legend=None)
    return rrb.Vertical(*rows, last, row_shares=[3, 3, 2], name="Residuals")


def _shares(rest: Residuals, first: int) -> Array:
    values = rest.position_mm if first == 0 else rest.turn_deg
    return np.asarray(values / rest.standard_errors[:, first : first + 3])


def _about_zero(values: ArrayLike, least: float = 0.0) -> tuple[float, float]:
    """A range about zero that contains the values and ± `least`, and ends just beyond a tick (see TICK_STEPS)."""
    size = np.abs(np.asarray(values, float))
    largest = max(float(size[np.isfinite(size)].max(initial=0.0)), least, 1e-9)
    power = 10.0 ** np.floor(np.log10(largest))
    limit = next(step * power for step in TICK_STEPS if step * power >= largest)
    return -1.05 * limit, 1.05 * limit


def _fit_tab(contents: RecordingContents) -> rrb.Container | rrb.View:
    text = rrb.TextDocumentView(origin="report/estimate", name="Fit")
    plots: list[rrb.View] = []
    if contents.chi_range is not None:
        plots.append(
            plot("plots/chi", "Restitution χ [1] of each bounce", contents.chi_range, legend=rrb.Corner2D.RightTop)
        )
    if contents.odds:
        plots.append(
            plot("plots/odds", "Odds of the landing face, by the frames to the end of each flight [1]", (-0.02, 1.02))
        )
    return rrb.Horizontal(text, rrb.Vertical(*plots), column_shares=[1, 1], name="Fit") if plots else text


def plot(
    origin: str,
    name: str,
    y_range: tuple[float, float] | None = None,
    *,
    legend: rrb.Corner2D | None = rrb.Corner2D.LeftBottom,
) -> rrb.TimeSeriesView:
    """A plot over time."""
    return rrb.TimeSeriesView(
        origin=origin,
        name=name,
        axis_x=over_all_times(),
        axis_y=rrb.ScalarAxis(range=y_range) if y_range is not None else None,
        plot_legend=rrb.PlotLegend(visible=False) if legend is None else rrb.PlotLegend(legend),
    )


def over_all_times() -> rrb.TimeAxis:
    """The whole recording, so that plots above each other have the same time axis."""
    always = rrb.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rr.TimeRange(always, always))
