"""How the viewer opens several throws in one recording: the tabs of a single throw, with one colour for each."""

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
    """One recording among others."""

    name: str
    """As a part of an entity path."""
    title: str
    measured_colour: Colour
    simulated_colour: Colour
    measured: bool
    simulated: bool
    film: bool
    odds: bool


@dataclass(frozen=True, eq=False)
class JoinedContents:
    """What the joined recording holds."""

    cast: tuple[JoinedThrow, ...]
    same_throw: bool
    """They differ in the model alone."""
    low_m: Array
    """(3,) lowest place of any die."""
    high_m: Array
    """(3,)."""
    eye_m: Array
    """(3,) from where the three-dimensional view looks at the middle of these."""
    radius_m: float
    """Of the largest die."""
    fps: float
    keeps_frames: bool
    """All have one frame rate, so that frames can be counted."""
    played: tuple[int, int]
    """First and last frame with a pose; nanoseconds where frames are not counted."""


def views_of(joined: JoinedContents) -> rrb.Blueprint:
    """Replay, Bounces, Residuals, Fit."""
    tabs = [_replay_tab(joined), _bounces_tab()]
    if any(cast.simulated and cast.measured for cast in joined.cast):
        tabs.append(_residuals_tab(joined))
    tabs.append(_fit_tab(joined))
    timeline = "frame" if joined.keeps_frames else "t"
    return rrb.Blueprint(rrb.Tabs(*tabs, active_tab=0), *panels(timeline, joined.fps, joined.played), auto_views=False)


def _replay_tab(joined: JoinedContents) -> rrb.Container:
    films = _films(joined)
    heights = plot("plots/height", "Height of every corner [mm]", legend=None)
    if not joined.same_throw:
        heights = plot("plots/lowest", "Height of the lowest corner [mm]")
    scene = rrb.Vertical(_scene(joined), heights, row_shares=[3, 2])
    if not films:
        return rrb.Vertical(*scene.contents, row_shares=[3, 2], name="Replay")
    columns = 1 if len(films) <= 2 else 2
    return rrb.Horizontal(rrb.Grid(*films, grid_columns=columns), scene, column_shares=[2, 3], name="Replay")


def _films(joined: JoinedContents) -> list[rrb.View]:
    """One film a throw; of models of one throw, that of the throw."""
    if joined.same_throw:
        return [rrb.Spatial2DView(origin="world/camera/image", name="Camera")] if joined.cast[0].film else []
    return [
        rrb.Spatial2DView(origin=f"world/{cast.name}/camera/image", name=cast.title)
        for cast in joined.cast
        if cast.film
    ]


def _scene(joined: JoinedContents) -> rrb.Spatial3DView:
    """All dice on one table: measured ones solid, models by their edges beside a measured die."""
    contents, motions = list(SCENERY), []
    if joined.same_throw and joined.cast[0].measured:
        motions.append("world/measured")
        contents += [f"+ world/measured/{part}" for part in ("die/**", "trail", "impacts")]
    for cast in joined.cast:
        solid = f"world/{cast.name}/" + ("measured" if cast.measured else "simulated")
        if joined.same_throw:
            motions.append(f"world/{cast.name}")
            contents += [f"+ world/{cast.name}/{part}" for part in ("die/edges", "trail")]
        else:
            motions.append(solid)
            contents += [f"+ {solid}/{part}" for part in ("die/**", "trail", "impacts")]
            contents += [f"+ world/{cast.name}/simulated/die/edges"] if cast.measured and cast.simulated else []
    name = "Measured solid, models by their edges" if joined.same_throw else "All throws, each model by its edges"
    return scene_view(name, contents, motions, joined.eye_m, 0.5 * (joined.low_m + joined.high_m), joined.fps)


def _bounces_tab() -> rrb.Container:
    left = rrb.Vertical(log_view(), lanes_view(), row_shares=[3, 2])
    spin = plot("plots/spin", "Angular speed [rad/s]", legend=rrb.Corner2D.LeftTop)
    right = rrb.Vertical(spin, plot("plots/energy", "Energy [mJ]"))
    return rrb.Horizontal(left, right, column_shares=[6, 5], name="Bounces")


def _residuals_tab(joined: JoinedContents) -> rrb.Container:
    """Of each, position and rotation in standard errors on one line, and all in one plot below."""
    rows = [
        rrb.Horizontal(
            *(
                plot(
                    f"plots/residual/{cast.name}/{what}_sigmas",
                    f"{cast.title}: {what} x red, y green, z violet [standard errors]; bands: 1 and 2",
                    (-5, 5),
                    legend=None,
                )
                for what in ("position", "turn")
            )
        )
        for cast in joined.cast
        if cast.measured and cast.simulated
    ]
    together = rrb.TimeSeriesView(
        origin="plots/residual",
        contents=[f"+ plots/residual/{cast.name}/rms_sigmas" for cast in joined.cast],
        name="All six, whitened: root mean square [standard errors]; noise alone gives 1",
        axis_x=over_all_times(),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
    )
    return rrb.Vertical(together, *rows, name="Residuals")


def _fit_tab(joined: JoinedContents) -> rrb.Container:
    pages = [rrb.TextDocumentView(origin=f"report/{cast.name}", name=cast.title) for cast in joined.cast]
    text = rrb.Vertical(rrb.TextDocumentView(origin="report/table", name="All"), rrb.Tabs(*pages), row_shares=[1, 2])
    odds = [
        plot(f"plots/odds/{cast.name}", f"{cast.title}: odds of the faces [1]", (-0.02, 1.02))
        for cast in joined.cast
        if cast.odds
    ]
    plots = rrb.Vertical(
        plot("plots/chi", "Restitution χ [1]: each bounce a dot with its 95 % interval, each fit a line", legend=None),
        *([rrb.Tabs(*odds)] if odds else []),
    )
    return rrb.Horizontal(text, plots, column_shares=[1, 1], name="Fit")
