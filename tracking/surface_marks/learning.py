"""Surface marks as features of a die's pose: pips, numbers, grain, whatever its faces show.

A rounded or shaded edge does not lie where the model of a sharp edge expects it, and its displacement is the same on
every frame, so that averaging does not help. A print on a flat face has no such error: the die's size determines the
plane of the face to a part in a thousand, whatever its edges look like. The appearance of each face is learned from
the clip itself, in four steps:

1. **Textures** (`textures`). On the flights of a first track, chosen frames are sampled on a grid of face
   coordinates. The light on each face and frame is fitted (`kernel_types` has the model), and the texture is the
   weighted mean of the samples.
2. **Signal** (`textures`). Two textures of independent noise show where there are marks.
3. **Adjustment** (`bundle_adjustment`). Textures placed by the poses that they are to improve contain the error that
   all those poses share. It shows when the die turns: a misplaced texture does not follow the rotation of a rigid
   body about its centre. Flights that meet at their impacts and the warps of every face's texture are adjusted together,
   with edges as weak observations; then the textures are learned again from the adjusted flights.
   Scale, and with it distance, comes from the known distance of the faces from the centre of rotation, from gravity,
   and from the table that the die's corners hit.
4. **Refinement** (`pose_refinement`). Single frames are refined on marks and edges.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.throw import Throw
from ..picture import BIWEIGHT_CUT, View, outline_box
from ..throw import VertexImpact
from ..track import Track
from .bundle_adjustment import adjust_flights, impact_constraints
from .pose_refinement import WINDOW_PX
from .textures import FEWEST_FRAMES, FrameWindow, SurfaceMarks, face_grid, unlearned_marks, with_learned_textures

LEARNED_FRAMES = 120
"""Most frames that are learned from: the noise of the texture is then a tenth of one frame's, and the cost does not
grow with the clip."""
SHORT_FLIGHT = 10
"""Frames of a flight below which all are used."""
CUTS = (
    8.0 * BIWEIGHT_CUT,
    3.0 * BIWEIGHT_CUT,
    1.5 * BIWEIGHT_CUT,
    BIWEIGHT_CUT,
    BIWEIGHT_CUT,
    BIWEIGHT_CUT,
    BIWEIGHT_CUT,
)
"""Cut of the robust weights [sigmas] in each round of adjusting and learning. A narrow cut from the start would
reject as occlusion what the first poses misplaced. Rounds with wide cuts use half of the frames."""
CONVERGED_SIGMAS = 0.5
"""A round that moves no flight by more of its sigmas is the last with a wide cut, or the last one: the next would
move it by a third of that."""
NO_FLIGHT_SIGMAS = 6.0
"""A flight that a round with the narrow cut moves by more sigmas is discarded: a die that rolls or slides does not
fall freely, and pulls at its neighbours from round to round. True flights move by two or three sigmas there at
most."""
NEAR_IMPACT_FRAMES = 1.0
"""Frames from an impact within which a frame is not learned from: its exposure may straddle the impact."""
FEWEST_OF_A_FLIGHT = 2
"""Frames in view below which a flight is not learned from."""


def frames_to_learn_from(track: Track, throw: Throw) -> NDArray[np.int64]:
    """Rows of the track, about LEARNED_FRAMES, spread evenly over the frames that certainly lie on a flight; short
    flights keep all of theirs."""
    spacing = float(np.median(np.diff(track.time_s))) if len(track) > 1 else 0.0
    impacts_s = np.array([impact.time_s for impact in throw.impacts])
    good = np.flatnonzero(track.tracked)
    if len(impacts_s):
        distance_s = np.abs(track.time_s[good, None] - impacts_s).min(1)
        good = good[distance_s > NEAR_IMPACT_FRAMES * spacing]
    flight = throw.flights_at(track.time_s[good])
    chosen = []
    for k in np.unique(flight):
        mine = good[flight == k]
        count = min(len(mine), max(int(np.ceil(LEARNED_FRAMES * len(mine) / len(good))), SHORT_FLIGHT))
        chosen.append(mine[np.unique(np.linspace(0, len(mine) - 1, count).round().astype(int))])
    return np.concatenate(chosen) if chosen else good


def learn_marks(
    view: View,
    images: Iterable[tuple[int, NDArray[Any]]],
    track: Track,
    throw: Throw,
    vertex_impacts: Sequence[VertexImpact | None],
    *,
    saturation_grey: float = np.inf,
) -> SurfaceMarks | None:
    """The surface marks of the die, or None if no face has marks.

    `images` are pairs of a row of `track` and its whole frame (height, width), best those of `frames_to_learn_from`;
    only a window of each is kept. `track` holds poses of single frames by edges, `throw` the flights measured through
    them, and `vertex_impacts` (impacts,) the laws of its impacts. Pixels at `saturation_grey` and above are left out.
    """
    windows = _windows(view, images, track, throw)
    if len(windows) < 2 * FEWEST_FRAMES:
        return None
    grid = face_grid(view, windows, throw)
    impacts = impact_constraints(windows, throw, vertex_impacts)
    half = _every_second(windows)
    marks = unlearned_marks(view, grid, saturation_grey, throw)
    marks = with_learned_textures(view, half, throw.flights, marks, CUTS[0])
    converged = False
    for cut in CUTS:
        wide = cut > BIWEIGHT_CUT
        if wide and converged:
            continue
        if not len(marks.marked_faces):
            return None
        marks, moved_sigmas = adjust_flights(view, half if wide else windows, impacts, marks, cut)
        if not wide and (moved_sigmas > NO_FLIGHT_SIGMAS).any():
            discarded = moved_sigmas > NO_FLIGHT_SIGMAS
            marks, windows = _without_flights(marks, windows, discarded, throw)
            # The impacts beside a discarded flight are as doubtful as the flight.
            impacts = [impact for impact in impacts if not discarded[list(impact.flights)].any()]
            if len(windows) < 2 * FEWEST_FRAMES:
                return None
        marks = with_learned_textures(view, half if wide else windows, marks.flights, marks, cut)
        converged = bool(moved_sigmas.max() < CONVERGED_SIGMAS)
        if converged and not wide:
            break
    return marks if len(marks.marked_faces) else None


def _without_flights(
    marks: SurfaceMarks, windows: list[FrameWindow], discarded: NDArray[np.bool_], throw: Throw
) -> tuple[SurfaceMarks, list[FrameWindow]]:
    """Marks and windows without the `discarded` flights (flights,), which become those of the edges again."""
    flights = tuple(throw.flights[k] if discarded[k] else flight for k, flight in enumerate(marks.flights))
    unknown = np.full((12, 12), np.nan)
    shared = tuple(unknown if discarded[k] else known for k, known in enumerate(marks.shared_covariance))
    windows = [window for window in windows if not discarded[window.flight]]
    return replace(marks, flights=flights, shared_covariance=shared), windows


def _windows(view: View, images: Iterable[tuple[int, NDArray[Any]]], track: Track, throw: Throw) -> list[FrameWindow]:
    """Windows round the die on the frames of flights that have FEWEST_OF_A_FLIGHT of them."""
    windows = []
    for row, image in images:
        time_s = float(track.time_s[row])
        flight = throw.flight_at(time_s)
        state = throw.flights[flight].at(time_s)
        box = outline_box(view, state.position_m, state.rotation, WINDOW_PX)
        if box is None or not track.tracked[row]:
            continue
        x0, y0, x1, y1 = box
        window = np.ascontiguousarray(image[y0:y1, x0:x1], np.float32)
        edges = track.position_m[row], track.quaternion[row], track.covariance[row]
        windows.append(FrameWindow(time_s, flight, x0, y0, window, *edges))
    counts = np.bincount([window.flight for window in windows], minlength=len(throw.flights))
    return [window for window in windows if counts[window.flight] >= FEWEST_OF_A_FLIGHT]


def _every_second(windows: list[FrameWindow]) -> list[FrameWindow]:
    """Every second window, and all of short flights: enough for the rounds with wide cuts, in half the time."""
    counts = np.bincount([window.flight for window in windows])
    return [window for i, window in enumerate(windows) if i % 2 == 0 or counts[window.flight] <= SHORT_FLIGHT]
