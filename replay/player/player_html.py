"""The player as a part of a page: the canvas, its controls, its data, and the script that draws.

Without scripts, the page shows the picture alone. The script is the page's only one, and the page's content security policy
names it by its hash, so that no other runs.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from functools import cache
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np

from ...model.die import Solid
from ...model.throw import Impact
from ..elements import COLOURS, Motion, hex_colour
from .packed_throw import grid_distance_m, packed_throw, shown_frames

if TYPE_CHECKING:
    from ...tracking.camera import Camera

PLAYED_S = 8.0
"""The duration of a throw on the screen: the nearest of SLOWDOWNS that takes no longer is chosen."""
SLOWDOWNS = (1, 2, 5, 10, 20, 50, 100, 200)
"""How many times slower than the throw it can be played."""
KEYS_HELP = "Arrow keys turn the view, + and − zoom, the space bar plays."


@cache
def player_script() -> str:
    """The script; a page has it once, after its players."""
    return f"<script>{_source('player.js')}</script>"


@cache
def player_style() -> str:
    """The style sheet of players."""
    return _source("player.css")


@cache
def player_policy() -> str:
    """What a content security policy says of scripts, so that this one runs and no other."""
    digest = base64.b64encode(hashlib.sha256(_source("player.js").encode()).digest()).decode("ascii")
    return f"script-src 'sha256-{digest}'"


def player_html(
    solid: Solid,
    motions: Sequence[Motion],
    impacts: Sequence[Impact],
    camera: Camera | None = None,
    picture: str = "",
) -> str:
    """The player of a throw: measured or simulated, or both in this order.

    `picture` is a figure as HTML whose first SVG image is the camera's whole frame: the die's outline is drawn on it. Without
    any pose there is only the picture.
    """
    if not any(len(motion.frame) for motion in motions):
        return picture
    grid_m = grid_distance_m(motions)
    data = packed_throw(solid, motions, impacts, camera if picture else None, grid_m)
    boxes = "".join(_box(motion.name) for motion in motions) if len(motions) > 1 else ""
    return f"""<div class="player" role="group" aria-label="The throw, to be played">
<script type="application/json">{data}</script>
<div class="views">
<figure class="scripted"><canvas data-part="view" tabindex="0" role="img" aria-label="{escape(_description(motions))}"></canvas>
<figcaption>{escape(_caption(motions, grid_m))} <span class="screen">Drag to turn the view.</span></figcaption></figure>
{picture}
</div>
<div class="controls">
<button type="button" data-part="play" aria-pressed="false">▶ Play</button>
<input type="range" data-part="time" min="0" value="0" step="1" aria-label="Frame">
<select data-part="speed" aria-label="Speed">{_speeds(motions)}</select>
<label><input type="checkbox" data-part="follow"> follow the die</label>
{boxes}
</div>
<p class="now scripted" data-part="now"></p>
</div>"""


def player_alone(solid: Solid, motions: Sequence[Motion], impacts: Sequence[Impact]) -> str:
    """A player with its style and its script, for a notebook."""
    return f"<style>{player_style()}</style>{player_html(solid, motions, impacts)}{player_script()}"


def _source(name: str) -> str:
    return (files(__package__) / name).read_text(encoding="utf-8")


def _box(name: str) -> str:
    dot = f'<span class="dot" style="background:{hex_colour(COLOURS[name])}"></span>'
    return f'<label><input type="checkbox" data-motion="{escape(name)}" checked> {dot}{escape(name)}</label>'


def _speeds(motions: Sequence[Motion]) -> str:
    times = np.concatenate([motion.time_s for motion in motions])
    duration_s = float(np.ptp(times))
    usual = max((each for each in SLOWDOWNS if each * duration_s <= PLAYED_S), default=SLOWDOWNS[0])
    return "".join(
        f'<option value="{each}"{" selected" if each == usual else ""}>{_slower(each)}</option>' for each in SLOWDOWNS
    )


def _slower(times: int) -> str:
    return "as fast as it was" if times == 1 else f"{times} times slower"


def _description(motions: Sequence[Motion]) -> str:
    return f"The die over the table, in 3D, {' and '.join(motion.name for motion in motions)}. {KEYS_HELP}"


def _caption(motions: Sequence[Motion], grid_m: float) -> str:
    step = shown_frames(motions)[1]
    which = "" if step == 1 else f" Every {step}th frame is shown." if step > 3 else f" One frame in {step} is shown."
    edges = "; orange edges are simulated" if len(motions) > 1 else ""
    return (
        f"The {motions[0].name} die with the numbers of its faces{edges}. Crosses: bounces. Lines on the table: "
        f"{1e3 * grid_m:g} mm apart.{which}"
    )
