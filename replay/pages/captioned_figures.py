"""The figures that belong to a throw, each with its name, size and caption: what the report shows, and what is exported.

What a record lacks has no plate: without a clip there is no stroboscope, without a fit there are no residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ...tracking.camera import Camera
from ...tracking.footage import Clip
from ..elements import Motion, Record, motions_of, residuals
from ..figures import COLUMNS, bounce_strip, rows_of_strip, stroboscope, throw_plots
from .account import ReportDetails
from .page_parts import SAVING, as_address, captioned, drawing, legended

WIDE, NARROW = 8.4, 5.2
"""Widths [inches]: of the page's text, and of what needs less."""
EXPORT_DPI = 200
STATE_NAMES = ("x", "y", "z", "rx", "ry", "rz", "vx", "vy", "vz", "ωx", "ωy", "ωz")
"""Of the components of a state's covariance."""

FRAMES_ALONE = "Every frame by itself, as the fit saw it: noise alone leaves the band of two once in twenty frames."
SMOOTHED = "Frames of one flight were smoothed together and err alike; the band holds two."


@dataclass(frozen=True, eq=False)
class CaptionedFigure:
    """One figure."""

    name: str
    """Of its file, without an ending."""
    inches: tuple[float, float]
    caption: str
    draw: Callable[[Axes], Axes]
    photograph: bool = False
    """Made of pixels: a page shows it as pixels."""

    @property
    def narrow(self) -> bool:
        """Whether it needs less than the width of the page."""
        return self.inches[0] <= NARROW

    def as_html(self) -> str:
        """The figure with its caption, in the page itself."""
        with drawing(self.inches) as figure:
            legended(self.draw(figure.subplots()))
            address = as_address(figure, "webp" if self.photograph else "svg")
        return captioned(address, self.caption, narrow=self.narrow)

    def write(self, folder: Path) -> tuple[Path, Path]:
        """`NAME.png` and `NAME.svg` in a folder. Raises OSError where they cannot be written."""
        png, svg = folder / f"{self.name}.png", folder / f"{self.name}.svg"
        with drawing(self.inches) as figure:
            legended(self.draw(figure.subplots()))
            figure.savefig(png, dpi=EXPORT_DPI, **SAVING["png"])
            figure.savefig(svg, dpi=EXPORT_DPI, **SAVING["svg"])
        return png, svg


def write_figures(folder: Path, record: Record, account: ReportDetails | None = None) -> tuple[Path, ...]:
    """Every figure of a throw as PNG and SVG. Raises OSError where they cannot be written."""
    folder.mkdir(exist_ok=True)
    return tuple(path for plate in report_figures(record, account or ReportDetails()) for path in plate.write(folder))


def report_figures(record: Record, account: ReportDetails) -> list[CaptionedFigure]:
    """The figures that a record can fill, in the order of the report."""
    return [
        *clip_figures(record),
        height_figure(record),
        *restitution_figures(record),
        *residual_figures(record, account),
        *fit_figures(record),
    ]


def clip_figures(record: Record) -> Iterator[CaptionedFigure]:
    """The die on the frames of the clip."""
    clip, camera, solid, motions = record.clip, record.camera, record.die.solid, motions_of(record)
    if clip is None or camera is None or not _is_on_film(clip, motions[0]):
        return
    yield CaptionedFigure(
        "stroboscope",
        (NARROW, NARROW * clip.height_px / clip.width_px + 0.3),
        f"The whole throw in one picture: the die cut out of frames of the clip, {_edges_in_words(motions)}.",
        lambda ax: stroboscope(ax, clip, camera, solid, motions),
        photograph=True,
    )
    yield from _strip(record, clip, camera, motions)


def _strip(record: Record, clip: Clip, camera: Camera, motions: Sequence[Motion]) -> Iterator[CaptionedFigure]:
    impacts, solid = record.measured.bounces, record.die.solid
    rows = rows_of_strip(clip, camera, solid, motions[0], impacts)
    if not rows:
        return
    shown = rows[-1][0][-1] + 1
    which = "Every bounce" if shown == len(impacts) else f"The first {shown} of {len(impacts)} bounces"
    yield CaptionedFigure(
        "bounces",
        (WIDE, WIDE / COLUMNS * len(rows) + 0.3),
        f"{which}, frame by frame, with the time from the impact in milliseconds; {_edges_in_words(motions)}.",
        lambda ax: bounce_strip(ax, clip, camera, solid, motions, impacts),
        photograph=True,
    )


def height_figure(record: Record) -> CaptionedFigure:
    """Experiment over model, as the paper's Fig. 5."""
    track, simulated, solid = record.track, record.simulated, record.die.solid

    def draw(ax: Axes) -> Axes:
        measured = track.time_s, track.position_m, track.quaternion
        throw_plots.corner_heights(ax, solid, *measured, record.measured.bounces, label="measured")
        if simulated is not None:
            seen = np.flatnonzero(track.tracked)
            # The model goes on where nothing was seen; the figure shows the stretch that can be compared.
            rows = slice(seen[0], seen[-1] + 1) if len(seen) and len(simulated) == len(track) else slice(None)
            model = simulated.time_s[rows], simulated.position_m[rows], simulated.quaternion[rows]
            throw_plots.corner_heights(ax, solid, *model, label="simulated")
        return ax

    caption = "Height of every corner over time: measured dots"
    caption += ", simulated lines" if simulated is not None else ""
    return CaptionedFigure("heights", (WIDE, 4.0), caption + ". Dashed: the bounces.", draw)


def restitution_figures(record: Record) -> Iterator[CaptionedFigure]:
    """χ bounce by bounce."""
    impacts = record.measured.bounces
    if not any(np.isfinite(impact.chi) for impact in impacts):
        return
    chi = record.fit.parameters.get("chi") if record.fit is not None else None
    caption = "Apparent restitution of every bounce with its interval"
    caption += ", and the fitted χ with its own as a band." if chi is not None and chi.value is not None else "."
    yield CaptionedFigure("restitution", (NARROW, 2.9), caption, lambda ax: throw_plots.restitution(ax, impacts, chi))


def residual_figures(record: Record, account: ReportDetails) -> Iterator[CaptionedFigure]:
    """Measured minus simulated."""
    if record.simulated is None:
        return
    impacts = record.measured.bounces
    smoothed, alone = residuals(record.track, record.simulated), None
    if account.frames is not None:
        alone = residuals(account.frames, record.simulated)
    rest, in_sigmas = smoothed, alone or smoothed
    if np.isfinite(in_sigmas.standard_errors).any():
        yield CaptionedFigure(
            "residuals_position_sigmas",
            (WIDE, 2.3),
            "Measured minus simulated position, world axes, in standard errors of the measured one. "
            + (SMOOTHED if alone is None else FRAMES_ALONE),
            lambda ax: throw_plots.position_sigmas(ax, in_sigmas, impacts),
        )
        yield CaptionedFigure(
            "residuals_rotation_sigmas",
            (WIDE, 2.3),
            "The rotation from the simulated to the measured orientation about the world axes, likewise.",
            lambda ax: throw_plots.turn_sigmas(ax, in_sigmas, impacts),
        )
    if len(rest.frame):
        yield CaptionedFigure(
            "residuals_position",
            (WIDE, 2.3),
            "Measured minus simulated position in millimetres.",
            lambda ax: throw_plots.position_residuals(ax, rest, impacts),
        )
        yield CaptionedFigure(
            "residuals_angle",
            (WIDE, 2.1),
            "Angle between the measured and the simulated orientation.",
            lambda ax: throw_plots.angle_residuals(ax, rest, impacts),
        )


def fit_figures(record: Record) -> Iterator[CaptionedFigure]:
    """What the fit says of its numbers, and of the landing."""
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
            "Correlations of what was fitted, in hundredths: position, rotation vector, velocity and angular velocity at the "
            "beginning, in world axes, and the free parameters.",
            lambda ax: throw_plots.correlations(ax, covariance, names),
        )
    odds = fit.face_odds
    if odds:
        caption = "Where throws that are drawn from the fit and simulated on come to rest."
        yield CaptionedFigure("odds", (NARROW, 2.6), caption, lambda ax: throw_plots.face_odds(ax, odds))
    if sum(bool(estimate.face_odds) for estimate in record.estimates) > 1:
        caption = (
            "Odds of the faces from the frames up to the end of each flight, by the effects of the whole fit. "
            "Dashed: the bounces."
        )
        impacts = record.measured.bounces
        yield CaptionedFigure(
            "odds_on_the_way",
            (WIDE, 2.6),
            caption,
            lambda ax: throw_plots.odds_on_the_way(ax, record.estimates, impacts),
        )


def as_html(chosen: Iterable[CaptionedFigure]) -> str:
    """Plates one below the other."""
    return "\n".join(plate.as_html() for plate in chosen)


def _is_on_film(clip: Clip, motion: Motion) -> bool:
    return bool(((motion.frame >= clip.first_frame) & (motion.frame < clip.first_frame + len(clip))).any())


def _edges_in_words(motions: Sequence[Motion]) -> str:
    return "measured edges blue" + (", simulated orange" if len(motions) > 1 else "")
