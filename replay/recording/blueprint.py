"""How the viewer opens a recording: four tabs, the same for every throw, without views that would stay empty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike, NDArray

from ..elements import Residuals

Array = NDArray[np.float64]

TRAIL_FRAMES = 40
"""Length of the corner trails behind the cursor."""

PLAYBACK_SPEED = 0.02
"""A throw of 0.2 s plays for ten seconds."""

NEAR = 5.0
"""Distance of the eye that follows the die, in its radii: the die fills half of the view, its trails the rest."""

BOUNCE_PARTS = ("impacts", "impulses")
"""Entities below each motion of which the views show every row up to the cursor; of a label only the last is readable."""

GROUND = (24, 26, 30)
"""Of the three-dimensional views."""


@dataclass(frozen=True, eq=False)
class RecordingContents:
    """What the recording holds."""

    motions: tuple[str, ...]
    """`measured`, `simulated`, or both."""
    fps: float
    """[Hz]."""
    eye_m: Array
    """(3,) from where the three-dimensional views look."""
    target_m: Array
    """(3,) at what they look."""
    frames: tuple[int, int]
    """First and last frame with a pose: what is played."""
    height_mm: float
    """Of the highest corner."""
    radius_m: float
    """Of the sphere through the corners of the die."""
    picture_px: tuple[int, int] | None = None
    """Width and height of the film; None where there is none."""
    residuals: Residuals | None = None
    chi_range: tuple[float, float] | None = None
    """Of the plot of χ; None where no χ is known."""
    odds: bool = False
    bounces: bool = False


def blueprint(shown: RecordingContents) -> rrb.Blueprint:
    """Replay, Bounces, Residuals, Fit: those of them that have something to show."""
    tabs = [_replay_tab(shown)]
    if shown.bounces:
        tabs.append(_bounces_tab())
    if shown.residuals is not None:
        tabs.append(_residuals_tab(shown.residuals))
    tabs.append(_fit_tab(shown))
    return rrb.Blueprint(rrb.Tabs(*tabs, active_tab=0), *panels("frame", shown.fps, shown.frames), auto_views=False)


def panels(timeline: str, fps: float, played: tuple[int, int]) -> tuple[rrb.BlueprintPart, ...]:
    """Nothing about the views but the time panel: paused at the beginning, slow, going round what shows the die."""
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


def _replay_tab(shown: RecordingContents) -> rrb.Container:
    both = len(shown.motions) == 2
    sides = [_side_view(shown, motion) for motion in shown.motions]
    overlay = [_overlay_view(shown)] if both else []
    film = [_film_view(shown.picture_px)] if shown.picture_px is not None else []
    if not film and not both:
        return rrb.Vertical(*sides, _heights_view(shown), row_shares=[3, 2], name="Replay")
    right = rrb.Vertical(rrb.Horizontal(*sides), _heights_view(shown), row_shares=[3, 2])
    return rrb.Horizontal(rrb.Vertical(*film, *overlay), right, column_shares=[2, 3], name="Replay")


def _side_view(shown: RecordingContents, motion: str) -> rrb.Spatial3DView:
    """The table, the camera, and one die with its bounces."""
    contents = [f"+ world/{motion}/{part}" for part in ("die/**", "trail", "impacts/**", "impulses/**")]
    return scene_view(
        motion.capitalize(), [*SCENERY, *contents], [f"world/{motion}"], shown.eye_m, shown.target_m, shown.fps
    )


def _overlay_view(shown: RecordingContents) -> rrb.Spatial3DView:
    """Both dice in one view that stays close to the measured one."""
    # Without the measured edges, which would hide the model's where the two agree.
    motions = {"measured": ("die", "trail", "impacts/**"), "simulated": ("die/edges",)}
    contents = [f"+ world/{motion}/{part}" for motion, parts in motions.items() for part in parts]
    towards = (shown.eye_m - shown.target_m) / np.linalg.norm(shown.eye_m - shown.target_m)
    return scene_view(
        "Overlay: measured solid, simulated edges",
        [*SCENERY, *contents],
        [f"world/{motion}" for motion in motions],
        shown.target_m + NEAR * shown.radius_m * towards,
        shown.target_m,
        shown.fps,
        follow="world/measured/die",
    )


# Paths are named one by one: a glob in the middle of a path silently matches nothing.
SCENERY = ("+ world/table/**", "+ world/camera")


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
    """A three-dimensional view; below each entity of `motions` lie a trail, impacts and impulses. The eye moves along with
    the entity `follow`."""
    overrides = {f"{motion}/trail": _last(TRAIL_FRAMES, fps) for motion in motions}
    overrides |= {f"{motion}/{part}": _so_far() for motion in motions for part in BOUNCE_PARTS}
    return rrb.Spatial3DView(
        origin="world",
        contents=contents,
        name=name,
        overrides=overrides,
        background=rrb.Background(color=GROUND),
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
    """So many frames up to the cursor, on either timeline."""
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


def _film_view(picture_px: tuple[int, int]) -> rrb.Spatial2DView:
    width, height = picture_px
    return rrb.Spatial2DView(
        origin="world/camera/image",
        name="Camera: measured edges blue, simulated orange",
        visual_bounds=rrb.VisualBounds2D(x_range=(0.0, width), y_range=(0.0, height)),
    )


def _heights_view(shown: RecordingContents) -> rrb.TimeSeriesView:
    """Sixteen names would hide the curves: the title carries the legend."""
    legend = ", ".join({"measured": "measured wide", "simulated": "simulated narrow"}[name] for name in shown.motions)
    name = f"Height of every corner [mm]: {legend}; upright lines: bounces"
    return plot("plots/height", name, (-0.04 * shown.height_mm, 1.04 * shown.height_mm), legend=None)


# --- Bounces, residuals, fit ---


def _bounces_tab() -> rrb.Container:
    left = rrb.Vertical(log_view(), lanes_view(), row_shares=[3, 2])
    right = rrb.Vertical(
        plot("plots/spin", "Angular speed [rad/s]", legend=rrb.Corner2D.LeftTop), plot("plots/energy", "Energy [mJ]")
    )
    return rrb.Horizontal(left, right, column_shares=[6, 5], name="Bounces")


def log_view() -> rrb.TextLogView:
    """The event log. Path and level would leave half the width to the sentence, and that says whose bounce it is."""
    columns = rrb.TextLogColumns(text_log_columns=["Body"])
    return rrb.TextLogView(origin="events", name="Bounces, and what each told", columns=columns)


def lanes_view() -> rrb.StateTimelineView:
    """Flights, what is held on the table, and what tracking knows."""
    return rrb.StateTimelineView(origin="phase", name="Flights and contacts")


def _residuals_tab(rest: Residuals) -> rrb.Container:
    rows = [
        rrb.Horizontal(
            plot(
                f"plots/residual/{what}_{unit}", f"{name} [{symbol}], each with its standard error", _about_zero(values)
            ),
            plot(
                f"plots/residual/{what}_sigmas", f"{name} [standard errors]; bands: 1 and 2", _about_zero(sigmas, 2.2)
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
    """A range about zero that holds the values: 1, 2, 3 or 10 of a power of ten, for the viewer labels only those."""
    size = np.abs(np.asarray(values, float))
    most = max(float(size[np.isfinite(size)].max(initial=0.0)), least, 1e-9)
    power = 10.0 ** np.floor(np.log10(most))
    limit = next(step * power for step in (1.0, 2.0, 3.0, 10.0) if step * power >= most)
    return -1.05 * limit, 1.05 * limit


def _fit_tab(shown: RecordingContents) -> rrb.Container | rrb.View:
    text = rrb.TextDocumentView(origin="report/estimate", name="Fit")
    plots: list[rrb.View] = []
    if shown.chi_range is not None:
        plots.append(
            plot("plots/chi", "Restitution χ [1], bounce by bounce", shown.chi_range, legend=rrb.Corner2D.RightTop)
        )
    if shown.odds:
        plots.append(
            plot("plots/odds", "Odds of the faces, from the frames to the end of each flight [1]", (-0.02, 1.02))
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
    """The whole recording, so that one instant stands at one place in plots above each other."""
    always = rrb.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rr.TimeRange(always, always))
