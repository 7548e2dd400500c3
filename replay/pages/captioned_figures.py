"""The figures of a throw with their names, sizes and captions, as the report shows them and as they are exported.

Figures need their data: without a clip there is no multiple exposure, without a fit there are no residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...tracking.footage import Clip
from ..elements import Motion, Record, ReportDetails, motions_of, residuals
from ..figures import (
    COLUMNS,
    angle_residuals,
    bounce_strip,
    corner_heights,
    correlations,
    correlations_of,
    landing_odds,
    legend_above,
    odds_over_time,
    position_residuals,
    position_sigmas,
    restitution,
    rows_of_strip,
    stroboscope,
    turn_sigmas,
)
from .matplotlib_figures import SAVING_OPTIONS, drawing
from .page_parts import WIDE, captioned, matrix_table, plotted

NARROW = 5.2
"""Width of a small figure [inches]."""
EXPORT_DPI = 200
STATE_NAMES = ("x", "y", "z", "rx", "ry", "rz", "vx", "vy", "vz", "ωx", "ωy", "ωz")
"""Components of a state's covariance."""

SINGLE_FRAMES = (
    "Each frame by itself, as the fit used it: by noise alone, one frame in twenty lies outside the band of ± 2."
)
SMOOTHED = "The poses of one flight are smoothed together, so their errors are correlated; the band is ± 2."


@dataclass(frozen=True, eq=False)
class CaptionedFigure:
    """One figure."""

    name: str
    """Name of its file, without suffix."""
    inches: tuple[float, float]
    caption: str
    draw: Callable[[Any], Any]
    """Draws it on axes, and returns these."""
    table: str = ""
    """HTML that a page shows in its place, where numbers say more; it is then drawn on matplotlib's axes only."""

    @property
    def narrow(self) -> bool:
        """Whether it is narrower than the text of the page."""
        return self.inches[0] <= NARROW

    def as_html(self) -> str:
        """The figure with its caption, contained in the page."""
        content = self.table or plotted(self.inches, self.draw, self.caption)
        return captioned(content, self.caption, narrow=self.narrow and not self.table)

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Write `NAME.png` and `NAME.svg` into a folder and return their paths. Raises OSError if that fails."""
        png, svg = folder / f"{self.name}.png", folder / f"{self.name}.svg"
        with drawing(self.inches) as figure:
            self.draw(figure.subplots())
            figure.savefig(png, dpi=EXPORT_DPI, **SAVING_OPTIONS["png"])
            figure.savefig(svg, dpi=EXPORT_DPI, **SAVING_OPTIONS["svg"])
        return png, svg


def write_figures(folder: Path, record: Record, details: ReportDetails | None = None) -> tuple[Path, ...]:
    """Write every figure of a throw as PNG and SVG, and return their paths. Raises OSError if that fails."""
    folder.mkdir(exist_ok=True)
    figures = report_figures(record, details or ReportDetails())
    return tuple(path for figure in figures for path in figure.write(folder))


def report_figures(record: Record, details: ReportDetails) -> list[CaptionedFigure]:
    """All figures for which the record has data, in the order of the report."""
    return [
        *clip_figures(record),
        height_figure(record),
        *restitution_figures(record),
        *residual_figures(record, details),
        *fit_figures(record),
    ]


def clip_figures(record: Record) -> Iterator[CaptionedFigure]:
    """The multiple exposure and the strips of bounces."""
    clip, camera, solid, motions = record.clip, record.camera, record.die.solid, motions_of(record)
    if clip is None or camera is None or not _has_poses_in(clip, motions[0]):
        return
    impacts = record.measured.bounces
    strip = rows_of_strip(clip, camera, solid, motions[0], impacts)
    yield CaptionedFigure(
        "stroboscope",
        (NARROW, NARROW * clip.height_px / clip.width_px + 0.3),
        f"The whole throw in one picture: the die cut out of frames of the clip; {_edge_colours(motions)}.",
        lambda ax: stroboscope(ax, clip, camera, solid, motions),
    )
    if strip:
        shown = strip[-1][0][-1] + 1
        which = "Every bounce" if shown == len(impacts) else f"The first {shown} of {len(impacts)} bounces"
        yield CaptionedFigure(
            "bounces",
            (WIDE, WIDE / COLUMNS * len(strip) + 0.3),
            f"{which}, frame by frame, with the time from the impact in milliseconds; {_edge_colours(motions)}.",
            lambda ax: bounce_strip(ax, clip, camera, solid, motions, impacts),
        )


def height_figure(record: Record) -> CaptionedFigure:
    """Height of every corner, measured and simulated, as in the paper's Fig. 5."""
    track, simulated, solid = record.track, record.simulated, record.die.solid

    def draw(ax: Any) -> Any:
        measured = track.time_s, track.position_m, track.quaternion
        corner_heights(ax, solid, *measured, record.measured.bounces, label="measured")
        if simulated is not None:
            tracked = np.flatnonzero(track.tracked)
            # The model continues beyond the tracked frames; only the frames with both can be compared.
            both = bool(len(tracked)) and len(simulated) == len(track)
            rows = slice(tracked[0], tracked[-1] + 1) if both else slice(None)
            model = simulated.time_s[rows], simulated.position_m[rows], simulated.quaternion[rows]
            corner_heights(ax, solid, *model, label="simulated")
        legend_above(ax, 2, markerscale=2.0)
        return ax

    caption = "Height of every corner over time: dots measured"
    caption += ", lines simulated" if simulated is not None else ""
    return CaptionedFigure("heights", (WIDE, 4.0), caption + ". Dashed lines: bounces.", draw)


def restitution_figures(record: Record) -> Iterator[CaptionedFigure]:
    """The apparent restitution of each bounce."""
    impacts = record.measured.bounces
    if not any(np.isfinite(impact.chi) for impact in impacts):
        return
    chi = record.fit.parameters.get("chi") if record.fit is not None else None
    caption = "Apparent restitution of every bounce with its interval"
    caption += "; line and band: the fitted χ with its interval." if chi is not None and chi.value is not None else "."
    yield CaptionedFigure("restitution", (NARROW, 2.9), caption, lambda ax: restitution(ax, impacts, chi))


def residual_figures(record: Record, details: ReportDetails) -> Iterator[CaptionedFigure]:
    """Measured minus simulated."""
    if record.simulated is None:
        return
    impacts = record.measured.bounces
    smoothed, single_frames = residuals(record.track, record.simulated), None
    if details.frames is not None:
        single_frames = residuals(details.frames, record.simulated)
    in_sigmas = single_frames or smoothed
    if np.isfinite(in_sigmas.standard_errors).any():
        yield CaptionedFigure(
            "residuals_position_sigmas",
            (WIDE, 2.3),
            "Position, measured minus simulated, along the world axes in standard errors of the measurement. "
            + (SMOOTHED if single_frames is None else SINGLE_FRAMES),
            lambda ax: position_sigmas(ax, in_sigmas, impacts),
        )
        yield CaptionedFigure(
            "residuals_rotation_sigmas",
            (WIDE, 2.3),
            "Rotation from the simulated to the measured orientation about the world axes, in standard errors.",
            lambda ax: turn_sigmas(ax, in_sigmas, impacts),
        )
    if len(smoothed.frame):
        yield CaptionedFigure(
            "residuals_position",
            (WIDE, 2.3),
            "Position, measured minus simulated, in millimetres.",
            lambda ax: position_residuals(ax, smoothed, impacts),
        )
        yield CaptionedFigure(
            "residuals_angle",
            (WIDE, 2.1),
            "Angle between the measured and the simulated orientation.",
            lambda ax: angle_residuals(ax, smoothed, impacts),
        )


def fit_figures(record: Record) -> Iterator[CaptionedFigure]:
    """The correlations of the fit, and the odds of the landing face."""
    fit = record.fit
    if fit is None:
        return
    covariance, names = fit.covariance, (*STATE_NAMES, *(name for name, p in fit.parameters.items() if p.free))
    if covariance is None or len(covariance) != len(names):
        covariance, names = fit.initial_covariance, STATE_NAMES
    if covariance is not None and np.isfinite(covariance).all():
        yield CaptionedFigure(
            "correlations",
            (NARROW, 4.5),
            "Correlations of the fit, in hundredths: initial position, rotation vector, velocity and angular velocity in "
            "world axes, and the free parameters.",
            lambda ax: correlations(ax, covariance, names),
            matrix_table(correlations_of(covariance), names),
        )
    odds = fit.face_odds
    if odds:
        caption = "Landing faces of throws that are sampled from the fit and simulated until they come to rest."
        yield CaptionedFigure("odds", (NARROW, 2.6), caption, lambda ax: landing_odds(ax, odds))
    if sum(bool(estimate.face_odds) for estimate in record.estimates) > 1:
        caption = (
            "Odds of the landing faces from the frames up to the end of each flight, with the effects that the fit of the "
            "whole throw includes. Dashed lines: bounces."
        )
        impacts = record.measured.bounces
        yield CaptionedFigure(
            "odds_on_the_way",
            (WIDE, 2.6),
            caption,
            lambda ax: odds_over_time(ax, record.estimates, impacts),
        )


def as_html(chosen: Iterable[CaptionedFigure]) -> str:
    """Figures one below the other."""
    return "\n".join(figure.as_html() for figure in chosen)


def _has_poses_in(clip: Clip, motion: Motion) -> bool:
    return bool(((motion.frame >= clip.first_frame) & (motion.frame < clip.first_frame + len(clip))).any())


def _edge_colours(motions: Sequence[Motion]) -> str:
    return "blue edges are measured" + (", orange ones simulated" if len(motions) > 1 else "")
