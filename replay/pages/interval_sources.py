"""What the intervals of a fit are made of: the shares of each source in a parameter's variance, as bars with their numbers."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from ...fitting.results import Fit
from ..elements import AXIS_COLOURS, MEASURED, SIMULATED, THROW_COLOURS, hex_colour, parameter_text

SOURCES = {
    "noise": (MEASURED, "noise of the frames"),
    "calibration": (AXIS_COLOURS[1], "calibration of the camera"),
    "die": (AXIS_COLOURS[2], "edge of the die"),
    "clock": (THROW_COLOURS[1], "frame rate"),
    "impact law": (SIMULATED, "misfit of the impact law"),
}
"""Colour and name of each source of error."""
LEAST_SHARE = 0.005
"""Shares below half of a per cent are left out."""


def sources_html(fit: Fit) -> str:
    """A row for each parameter whose shares are known; nothing where none is."""
    rows = [(name, shares) for name, shares in fit.variance_shares.items() if shares]
    if not rows:
        return ""
    body = "\n".join(
        f"<tr><td>{escape(parameter_text(name))}</td><td>{_bar(shares)}<span>{escape(share_words(shares))}</span></td></tr>"
        for name, shares in rows
    )
    return (
        "<h3>What the intervals are made of</h3>\n<p>Shares of the variance of each parameter. Errors that all frames share are "
        "estimated together with the throw: where they are known better, the noise of the frames weighs less as well.</p>\n"
        f'<div class="wide"><table class="facts">\n<tbody>\n{body}\n</tbody></table></div>'
    )


def share_words(shares: Mapping[str, float]) -> str:
    """`84 % noise of the frames, 11 % edge of the die`, the largest first."""
    listed = sorted(((share, SOURCES[name][1]) for name, share in shares.items() if share >= LEAST_SHARE), reverse=True)
    return ", ".join(f"{100.0 * share:.0f} % {words}" for share, words in listed)


def _bar(shares: Mapping[str, float]) -> str:
    parts = "".join(
        f'<i style="width:{100.0 * share:.2f}%;background:{hex_colour(SOURCES[name][0])}"></i>'
        for name, share in shares.items()
        if share > 0.0
    )
    return f'<span class="shares" aria-hidden="true">{parts}</span>'
