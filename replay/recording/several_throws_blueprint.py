"""The layout of the viewer for joined recordings: the tabs of a single throw, with one colour for each throw or model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from ..elements import Colour
from .blueprint import SCENERY, lanes_view, log_view, over_all_times, panels, plot, scene_view

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JoinedThrow:
    """One of the recordings that are joined."""

    name: str
    """As a part of an entity path."""
    title: str
    measured_colour: Colour
    simulated_colour: Colour
    measured: bool
    """Whether it has a measured die; the next three likewise."""
    simulated: bool
    video: bool
    odds: bool


@dataclass(frozen=True, eq=False)
class JoinedContents:
    """The contents of a joined recording, as far as the layout depends on them."""

    entries: tuple[JoinedThrow, ...]
    same_throw: bool
    """Whether they are models of one throw."""
    low_m: Array
    """(3,) lowest corner of the box that contains all dice."""
    high_m: Array
    """(3,) its highest corner."""
    eye_m: Array
    """(3,) viewpoint of the three-dimensional view, which points at the middle of the box."""
    radius_m: float
    """Radius of the largest die."""
    fps: float
    counts_frames: bool
    """Whether all have the same frame rate, so that the timeline `frame` exists."""
    played: tuple[int, int]
    """First and last frame with a pose; their times [ns] without the timeline `frame`."""


def views_of(joined: JoinedContents) -> rrb.Blueprint:
    """The tabs Replay, Bounces, Residuals and Fit."""
    tabs = [_replay_tab(joined), _bounces_tab()]
    if any(entry.simulated and entry.measured for entry in joined.entries):
        tabs.append(_residuals_tab(joined))
    tabs.append(_fit_tab(joined))
    timeline = "frame" if joined.counts_frames else "t"
    return rrb.Blueprint(rrb.Tabs(*tabs, active_tab=0), *panels(timeline, joined.fps, joined.played), auto_views=False)


def _replay_tab(joined: JoinedContents) -> rrb.Container:
    videos = _videos(joined)
    heights = plot("plots/height", "Height of every corner [mm]", legend=None)
    if not joined.same_throw:
        heights = plot("plots/lowest", "Height of the lowest corner [mm]")
    scene = rrb.Vertical(_scene(joined), heights, row_shares=[3, 2])
    if not videos:
        return rrb.Vertical(*scene.contents, row_shares=[3, 2], name="Replay")
    columns = 1 if len(videos) <= 2 else 2
    return rrb.Horizontal(rrb.Grid(*videos, grid_columns=columns), scene, column_shares=[2, 3], name="Replay")


def _videos(joined: JoinedContents) -> list[rrb.View]:
    """One video per throw; models of one throw share its video."""
    if joined.same_throw:
        return [rrb.Spatial2DView(origin="world/camera/image", name="Camera")] if joined.entries[0].video else []
    return [
        rrb.Spatial2DView(origin=f"world/{entry.name}/camera/image", name=entry.title)
        for entry in joined.entries
        if entry.video
    ]


def _scene(joined: JoinedContents) -> rrb.Spatial3DView:
    """All dice on one table: measured ones as solids, models as edges if there is a measured die."""
    contents, motions = list(SCENERY), []
    if joined.same_throw and joined.entries[0].measured:
        motions.append("world/measured")
        contents += [f"+ world/measured/{part}" for part in ("die/**", "trail", "impacts")]
    for entry in joined.entries:
        solid = f"world/{entry.name}/" + ("measured" if entry.measured else "simulated")
        if joined.same_throw:
            motions.append(f"world/{entry.name}")
            contents += [f"+ world/{entry.name}/{part}" for part in ("die/edges", "trail")]
        else:
            motions.append(solid)
            contents += [f"+ {solid}/{part}" for part in ("die/**", "trail", "impacts")]
            contents += [f"+ world/{entry.name}/simulated/die/edges"] if entry.measured and entry.simulated else []
    name = "Measured solid, edges of the models" if joined.same_throw else "All throws, each model as edges"
    return scene_view(name, contents, motions, joined.eye_m, 0.5 * (joined.low_m + joined.high_m), joined.fps)


def _bounces_tab() -> rrb.Container:
    left = rrb.Vertical(log_view(), lanes_view(), row_shares=[3, 2])
    spin = plot("plots/spin", "Angular speed [rad/s]", legend=rrb.Corner2D.LeftTop)
    right = rrb.Vertical(spin, plot("plots/energy", "Energy [mJ]"))
    return rrb.Horizontal(left, right, column_shares=[6, 5], name="Bounces")


def _residuals_tab(joined: JoinedContents) -> rrb.Container:
    """The root mean square of all in one plot; below it, position and rotation of each, in standard errors."""
    rows = [
        rrb.Horizontal(
            *(
                plot(
                    f"plots/residual/{entry.name}/{what}_sigmas",
                    f"{entry.title}: {what} x red, y green, z violet [standard errors]; bands: ± 1 and ± 2",
                    (-5, 5),
                    legend=None,
                )
                for what in ("position", "turn")
            )
        )
        for entry in joined.entries
        if entry.measured and entry.simulated
    ]
    all_entries = rrb.TimeSeriesView(
        origin="plots/residual",
        contents=[f"+ plots/residual/{entry.name}/rms_sigmas" for entry in joined.entries],
        name="All six, whitened: root mean square [standard errors]; noise alone gives 1",
        axis_x=over_all_times(),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
    )
    return rrb.Vertical(all_entries, *rows, name="Residuals")


def _fit_tab(joined: JoinedContents) -> rrb.Container:
    pages = [rrb.TextDocumentView(origin=f"report/{entry.name}", name=entry.title) for entry in joined.entries]
    text = rrb.Vertical(rrb.TextDocumentView(origin="report/table", name="All"), rrb.Tabs(*pages), row_shares=[1, 2])
    odds = [
        plot(f"plots/odds/{entry.name}", f"{entry.title}: odds of the faces [1]", (-0.02, 1.02))
        for entry in joined.entries
        if entry.odds
    ]
    plots = rrb.Vertical(
        plot("plots/chi", "Restitution χ [1]: dots and bars, bounces with 95 % intervals; lines, fits", legend=None),
        *([rrb.Tabs(*odds)] if odds else []),
    )
    return rrb.Horizontal(text, plots, column_shares=[1, 1], name="Fit")
