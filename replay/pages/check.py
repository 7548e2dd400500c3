"""The page of a check: every finding with its verdict, the die on film, and its fall."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
from matplotlib.axes import Axes

from ...model.die import Die
from ...tracking.camera import Camera
from ...tracking.check import Finding, Sight, Verdict
from ...tracking.footage import Clip
from ..elements import Motion
from ..figures import throw_plots
from .findings import COLOURS, findings_table
from .page_parts import as_address, captioned, drawing, plotted, whole_page

OWN_STYLE = "td:nth-child(-n+2) { white-space: nowrap; }"
SHOWN = 3
"""Frames of the clip side by side."""


def check_page(
    title: str, findings: tuple[Finding, ...], sights: Sequence[tuple[Sight | None, Clip, Camera]], die: Die
) -> str:
    """The whole page as HTML, with what each camera sees."""
    parts = [f"<h1>{escape(title)}</h1>", _summary(findings), findings_table(findings)]
    for k, (sight, clip, camera) in enumerate(sights):
        if sight is not None and sight.track.tracked.any():
            whose = f" with camera {k + 1}" if len(sights) > 1 else ""
            parts += [
                f"<h2>The frames that were tried{whose}</h2>",
                _film(sight, clip, camera, die),
                _heights(sight, die),
            ]
    return whole_page(title, parts, OWN_STYLE)


def _summary(findings: tuple[Finding, ...]) -> str:
    worst = max((finding.verdict for finding in findings), key=list(Verdict).index)
    headline = {
        Verdict.GOOD: "This clip can be tracked",
        Verdict.DOUBTFUL: "This clip can be tracked, with reservations",
        Verdict.BAD: "Something should be put right before this clip is tracked",
    }[worst]
    named = [finding.name for finding in findings if finding.verdict is worst]
    told = "" if worst is Verdict.GOOD else f"{worst.value.capitalize()}: {', '.join(named)}."
    colour = COLOURS[worst]
    return (
        f'<div class="verdict" style="border-left-color:{colour}"><p class="headline">{escape(headline)}</p>'
        f"<p>{escape(told)}</p></div>"
    )


def _film(sight: Sight, clip: Clip, camera: Camera, die: Die) -> str:
    track = sight.track
    rows = np.flatnonzero(track.tracked)
    chosen = rows[np.unique(np.linspace(0, len(rows) - 1, SHOWN).astype(int))]
    gone = np.flatnonzero(~track.tracked)
    seen = Motion(
        "measured", track.frame[rows], track.time_s[rows], track.position_m[rows], track.quaternion[rows],
        track.frame[gone], track.time_s[gone], sight.throw,
    )  # fmt: skip
    with drawing((8.4, 8.4 * clip.height_px / clip.width_px / SHOWN + 0.25)) as figure:
        for ax, row in zip(figure.subplots(1, SHOWN, squeeze=False)[0], chosen, strict=False):
            throw_plots.edges_on_frame(ax, clip, camera, die.solid, [seen], int(track.frame[row]))
            ax.set_title(f"frame {track.frame[row]}", fontsize=8.0, color="#5b6470")
        for ax in figure.axes:
            ax.set_axis_off()
        address = as_address(figure, "png")
    return captioned(address, "The die on film with the edges as they were found.")


def _heights(sight: Sight, die: Die) -> str:
    def draw(ax: Axes) -> Axes:
        track = sight.track
        impacts = sight.throw.impacts if sight.throw is not None else ()
        throw_plots.corner_heights(
            ax, die.solid, track.time_s, track.position_m, track.quaternion, impacts, label="measured"
        )
        return ax

    return captioned(plotted((8.4, 3.2), draw), "Height of every corner over time; the table is at 0. Dashed: bounces.")
