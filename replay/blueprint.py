"""How the viewer opens a recording: four tabs, the same for every throw, without views that would stay empty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

Array = NDArray[np.float64]

TRAIL_FRAMES = 40
"""Length of the corner trails behind the cursor."""

PLAYBACK_SPEED = 0.02
"""A throw of 0.2 s plays for ten seconds."""


@dataclass(frozen=True, eq=False)
class Shown:
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
    picture_px: tuple[int, int] | None = None
    """Width and height of the film; None where there is none."""
    residuals: bool = False
    chi: bool = False
    bounces: bool = False


def blueprint(shown: Shown) -> rrb.Blueprint:
    """Replay, Bounces, Residuals, Fit: those of them that have something to show."""
    tabs = [_replay_tab(shown)]
    if shown.bounces:
        tabs.append(_bounces_tab(shown))
    if shown.residuals:
        tabs.append(_residuals_tab())
    tabs.append(rrb.TextDocumentView(origin="report/estimate", name="Fit"))
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline="frame",
            fps=shown.fps,
            playback_speed=PLAYBACK_SPEED,
            loop_mode="selection",
            time_selection=rr.encodings.AbsoluteTimeRange(*shown.frames),
            play_state="playing",
        ),
        auto_views=False,
    )


def _replay_tab(shown: Shown) -> rrb.Container:
    sides = [_scene_view(shown, name.capitalize(), solid=(name,)) for name in shown.motions]
    right = rrb.Vertical(rrb.Horizontal(*sides), _heights_view(shown), row_shares=[3, 2])
    if shown.picture_px is not None:
        left = [_film_view(shown.picture_px)]
        if len(shown.motions) == 2:
            left.append(_scene_view(shown, "Overlay", solid=("measured",), wire=("simulated",)))
        return rrb.Horizontal(rrb.Vertical(*left), right, column_shares=[2, 3], name="Replay")
    if len(shown.motions) == 2:
        overlay = _scene_view(shown, "Overlay", solid=("measured",), wire=("simulated",))
        return rrb.Horizontal(overlay, right, column_shares=[2, 3], name="Replay")
    return rrb.Vertical(*right.contents, row_shares=[3, 2], name="Replay")


def _scene_view(shown: Shown, name: str, *, solid: tuple[str, ...], wire: tuple[str, ...] = ()) -> rrb.Spatial3DView:
    """The table and some dice: solid ones, and ones of which only the edges are drawn."""
    # Paths are named one by one: a glob in the middle of a path silently matches nothing.
    contents = ["+ world/table/**", "+ world/camera"]
    for motion in solid:
        contents += [f"+ world/{motion}/die/**", f"+ world/{motion}/trail", f"+ world/{motion}/impacts"]
    contents += [f"+ world/{motion}/die/edges" for motion in wire] + [f"+ world/{motion}/trail" for motion in wire]
    trails = {f"world/{motion}/trail": _behind_cursor(shown.fps) for motion in (*solid, *wire)}
    return rrb.Spatial3DView(
        origin="world",
        contents=contents,
        name=name,
        overrides=trails,
        background=rrb.Background(color=(24, 26, 30)),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=shown.eye_m, look_target=shown.target_m, eye_up=(0.0, 0.0, 1.0)
        ),
    )


def _behind_cursor(fps: float) -> rrb.VisibleTimeRanges:
    """The last TRAIL_FRAMES frames, on either timeline."""
    nanoseconds = round(TRAIL_FRAMES / fps * 1e9)
    return rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(
                "frame",
                start=rrb.TimeRangeBoundary.cursor_relative(seq=-TRAIL_FRAMES),
                end=rrb.TimeRangeBoundary.cursor_relative(seq=0),
            ),
            rrb.VisibleTimeRange(
                "t",
                start=rrb.TimeRangeBoundary.cursor_relative(nanos=-nanoseconds),
                end=rrb.TimeRangeBoundary.cursor_relative(nanos=0),
            ),
        ]
    )


def _film_view(picture_px: tuple[int, int]) -> rrb.Spatial2DView:
    width, height = picture_px
    return rrb.Spatial2DView(
        origin="world/camera/image",
        name="Camera: measured edges blue, simulated orange",
        visual_bounds=rrb.VisualBounds2D(x_range=(0.0, width), y_range=(0.0, height)),
    )


def _heights_view(shown: Shown) -> rrb.TimeSeriesView:
    """Sixteen names would hide the curves: the title carries the legend."""
    legend = ", ".join({"measured": "measured dots", "simulated": "simulated lines"}[name] for name in shown.motions)
    return rrb.TimeSeriesView(
        origin="plots/height",
        name=f"Height of every corner [mm]: {legend}",
        axis_y=rrb.ScalarAxis(range=(-0.04 * shown.height_mm, 1.04 * shown.height_mm)),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _bounces_tab(shown: Shown) -> rrb.Container:
    log = rrb.TextLogView(
        origin="events",
        name="Bounces",
        # Path and level would leave half the width to the sentence, and the sentence says whose bounce it is.
        columns=rrb.TextLogColumns(text_log_columns=["Body"]),
    )
    lanes = rrb.StateTimelineView(origin="phase", name="Tracking and flights")
    plots = [_plot("plots/spin", "Angular speed [rad/s]"), _plot("plots/energy", "Energy [mJ]")]
    if shown.chi:
        name = "Restitution χ [1]: dots per bounce between the ends of their intervals, line fitted"
        plots.insert(0, rrb.TimeSeriesView(origin="plots/chi", name=name, plot_legend=rrb.PlotLegend(visible=False)))
    return rrb.Horizontal(
        rrb.Vertical(log, lanes, row_shares=[2, 1]), rrb.Vertical(*plots), column_shares=[1, 1], name="Bounces"
    )


def _residuals_tab() -> rrb.Container:
    return rrb.Vertical(
        _plot("plots/residual/position_mm", "Position, measured minus simulated [mm]"),
        _plot("plots/residual/angle_deg", "Angle between measured and simulated orientation [°]"),
        _plot("plots/residual/sigmas", "Both, in standard errors (root mean square of six; 1 is noise) [1]"),
        name="Residuals",
    )


def _plot(origin: str, name: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop))
