"""The page of a modelled throw: what became of it in words, its heights and bounces, and the viewer to play it."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from ...model.die import Die
from ...model.throw import Throw
from ..elements import bounce_sentence
from ..figures import throw_heights
from .captioned_figures import WIDE
from .embedded_viewer import VIEWER_PLACE, VIEWER_POLICY, viewer_html
from .page_parts import captioned, plotted, whole_page

MOST_BOUNCES = 50
"""Listed in words; a throw near χ = 1 has thousands."""


def throw_page(title: str, die: Die, throw: Throw, sentences: Sequence[str], replay: Path) -> str:
    """The whole page as HTML, with the recording at `replay` and the viewer in it. Raises OSError as `viewer_html`."""
    bounces = [bounce_sentence(k, impact) for k, impact in enumerate(throw.bounces[:MOST_BOUNCES], 1)]
    more = len(throw.bounces) - len(bounces)
    listed = [*bounces, *([f"and {more} more"] if more else [])]
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<div class="verdict"><p>{escape(" ".join(sentences))}</p></div>',
        VIEWER_PLACE,
        captioned(
            plotted((WIDE, 4.0), lambda ax: throw_heights(ax, die.solid, throw)),
            "Height of every corner over time. Dashed: the bounces.",
        ),
        "<h2>Bounces</h2>",
        "<ul>\n" + "\n".join(f"<li>{escape(line)}</li>" for line in listed or ["None."]) + "\n</ul>",
        viewer_html(replay),
    ]
    return whole_page(title, parts, policy=VIEWER_POLICY)
