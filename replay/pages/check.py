"""The page of a check: every finding with its verdict, the die in the image, and the heights of its corners."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from ...model.die import Die
from ...tracking.camera import Camera
from ...tracking.check import Finding, TrackedPart, Verdict
from ...tracking.footage import Clip
from ..elements import IMPACT, MEASURED, SIMULATED, hex_colour, motion_of
from ..figures import corner_heights, edges_on_frame
from ..svg import SvgAxes
from .page_parts import WIDE, captioned, plotted, whole_page

OWN_STYLE = "td:nth-child(-n+2) { white-space: nowrap; }"
SHOWN_FRAMES = 3
"""Frames of the clip side by side."""
VERDICT_COLOURS = {
    Verdict.GOOD: hex_colour(MEASURED),
    Verdict.DOUBTFUL: hex_colour(IMPACT),
    Verdict.BAD: hex_colour(SIMULATED),
}
HEADLINES = {
    Verdict.GOOD: "This clip can be tracked",
    Verdict.DOUBTFUL: "This clip can be tracked, with reservations",
    Verdict.BAD: "Correct the findings marked bad before tracking this clip",
}


def check_page(
    title: str,
    findings: tuple[Finding, ...],
    tracked_parts: Sequence[tuple[TrackedPart | None, Clip, Camera]],
    die: Die,
) -> str:
    """The page as HTML: the findings, and what each camera shows."""
    parts = [f"<h1>{escape(title)}</h1>", _summary(findings), findings_table(findings)]
    for k, (part, clip, camera) in enumerate(tracked_parts):
        if part is not None and part.track.tracked.any():
            suffix = f" of camera {k + 1}" if len(tracked_parts) > 1 else ""
            parts += [
                f"<h2>Tracked frames{suffix}</h2>",
                _frames(part, clip, camera, die),
                _heights(part, die),
            ]
    return whole_page(title, parts, OWN_STYLE)


def findings_table(findings: tuple[Finding, ...]) -> str:
    """One row per finding: its name, verdict, what was measured, and what to change."""
    rows = "\n".join(
        f"<tr><td>{escape(finding.name)}</td>"
        f'<td><span class="dot" style="background:{VERDICT_COLOURS[finding.verdict]}"></span>{finding.verdict.value}</td>'
        f"<td>{escape(finding.measured)}</td><td>{escape(finding.advice)}</td></tr>"
        for finding in findings
    )
    header = "<tr><th></th><th>verdict</th><th>measured</th><th>what to change</th></tr>"
    return f'<div class="wide"><table>\n<thead>{header}</thead>\n<tbody>\n{rows}\n</tbody></table></div>'


def _summary(findings: tuple[Finding, ...]) -> str:
    worst = max((finding.verdict for finding in findings), key=list(Verdict).index)
    names = ", ".join(finding.name for finding in findings if finding.verdict is worst)
    text = "" if worst is Verdict.GOOD else f"{worst.value.capitalize()}: {names}."
    return (
        f'<div class="verdict" style="border-left-color:{VERDICT_COLOURS[worst]}">'
        f'<p class="headline">{escape(HEADLINES[worst])}</p><p>{escape(text)}</p></div>'
    )


def _frames(part: TrackedPart, clip: Clip, camera: Camera, die: Die) -> str:
    motion = motion_of("measured", part.track, part.throw)
    chosen = motion.frame[np.unique(np.linspace(0, len(motion.frame) - 1, SHOWN_FRAMES).astype(int))]
    pictures = []
    for frame in chosen.tolist():
        ax = edges_on_frame(SvgAxes((WIDE / SHOWN_FRAMES, WIDE)), clip, camera, die.solid, [motion], frame)
        ax.set_xlabel(f"frame {frame}")
        ax.set_ylabel("")
        ax.set_xticks([])
        ax.set_yticks([])
        ax.spines[:].set_visible(False)
        pictures.append(ax.svg(f"frame {frame}"))
    row = f'<div class="row">{"".join(pictures)}</div>'
    return captioned(row, "Frames of the clip with the measured edges of the die.")


def _heights(part: TrackedPart, die: Die) -> str:
    track, impacts = part.track, part.throw.impacts if part.throw is not None else ()
    poses = track.time_s, track.position_m, track.quaternion
    caption = "Height of every corner over time; the table is at 0. Dashed lines: bounces."
    plot = plotted((WIDE, 3.2), lambda ax: corner_heights(ax, die.solid, *poses, impacts, label="measured"), caption)
    return captioned(plot, caption)
