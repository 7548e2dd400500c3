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
from scipy.ndimage import map_coordinates

from ...model.rotations import matrix_from_quat
from ...model.throw import Throw
from ..flights import VertexImpact
from ..picture import BIWEIGHT_CUT, View, outline_box
from ..track import Track
from .bundle_adjustment import adjust_flights, impact_constraints
from .pose_refinement import WINDOW_PX
from .textures import (
    FEWEST_FRAMES,
    FEWEST_MARKED_TEXELS,
    FaceGrid,
    FlightPoses,
    FrameWindow,
    SurfaceMarks,
    face_grid,
    flight_poses,
    unlearned_marks,
    with_learned_textures,
)

Array = NDArray[np.float64]

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
SAME_MARKS_CORRELATION = 0.5
"""Correlation of two textures of the die from which they show the same marks."""
DISTINCT_UNEXPLAINED = 0.3
"""Variance of a texture that one labelling leaves unexplained, over that of any other, at which it is believed at the most. It
rests on four labellings of two random clips: three right ones left 0.09 to 0.21 of the next, and a wrong one, of a die with pips
and an edge of 31 px, left 0.45."""
LEAST_SHARED = 0.5
"""Texels in common over the most that any labelling has below which a labelling is not compared: few agree by chance."""


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
    grid = face_grid(view, flight_poses(windows, throw.flights).position_m)
    impacts = impact_constraints(windows, throw, vertex_impacts)
    half = _every_second(windows)
    marks = unlearned_marks(view, grid, saturation_grey, throw.flights)
    marks = with_learned_textures(view, half, flight_poses(half, throw.flights), marks, CUTS[0])
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
        some = half if wide else windows
        marks = with_learned_textures(view, some, flight_poses(some, marks.flights), marks, cut)
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
        flight = throw.flight_at(float(track.time_s[row]))
        state = throw.flights[flight].at(float(track.time_s[row]))
        window = _window(view, track, row, image, flight, state.position_m, state.rotation)
        if window is not None and track.tracked[row]:
            windows.append(window)
    counts = np.bincount([window.flight for window in windows], minlength=len(throw.flights))
    return [window for window in windows if counts[window.flight] >= FEWEST_OF_A_FLIGHT]


def _window(
    view: View, track: Track, row: int, image: NDArray[Any], flight: int, position_m: Array, rotation: Array
) -> FrameWindow | None:
    """The window round the die at a pose, with the pose by edges; None if it is out of view."""
    box = outline_box(view, position_m, rotation, WINDOW_PX)
    if box is None:
        return None
    x0, y0, x1, y1 = box
    pixels = np.ascontiguousarray(image[y0:y1, x0:x1], np.float32)
    edges = track.position_m[row], track.quaternion[row], track.covariance[row]
    return FrameWindow(float(track.time_s[row]), flight, x0, y0, pixels, *edges)


def _every_second(windows: list[FrameWindow]) -> list[FrameWindow]:
    """Every second window, and all of short flights: enough for the rounds with wide cuts, in half the time."""
    counts = np.bincount([window.flight for window in windows])
    return [window for i, window in enumerate(windows) if i % 2 == 0 or counts[window.flight] <= SHORT_FLIGHT]


# --- the labelling of frames -------------------------------------------------------------------------------------------


def labels_by_marks(
    view: View, images: Iterable[tuple[int, NDArray[Any]]], track: Track, rates: Array, groups: NDArray[np.int64]
) -> list[Array]:
    """For each group of frames the rotation (3, 3) in body axes, a symmetry of the die, after which its faces show the marks that
    groups before it showed; that of the group before where the marks do not tell.

    `images` are pairs of a row of `track` and its whole frame (height, width). `rates` (n, 6) are velocity [m/s] and spin [rad/s]
    on each row; `groups` (n,) its group, from 0 on, within which one labelling holds."""
    count = int(groups.max()) + 1
    seen: list[list[tuple[int, FrameWindow]]] = [[] for _ in range(count)]
    for row, image in images:
        rotation, mine = matrix_from_quat(track.quaternion[row]), int(groups[row])
        window = _window(view, track, row, image, mine, track.position_m[row], rotation)
        if window is not None:
            seen[mine].append((row, window))
    labels: list[Array] = [np.eye(3)]
    rows = [row for group in seen for row, _ in group]
    if not rows:
        return labels * count
    shown: Array | None = None
    grid = face_grid(view, track.position_m[rows])
    for group in seen:
        found, texture = None, None
        if len(group) >= FEWEST_FRAMES:
            own = np.array([row for row, _ in group])
            texture = _texture_of(view, grid, [window for _, window in group], track, rates, own)
        if texture is not None and shown is not None:
            found = _same_marks(grid, shown, texture, view.symmetries)
        labels.append(labels[-1] if found is None else found)
        if texture is not None and (shown is None or found is not None):
            turned = _relabelled(grid, texture, labels[-1])
            shown = turned if shown is None else np.where(np.isfinite(shown), shown, turned)
    return labels[1:]


def _texture_of(
    view: View, grid: FaceGrid, windows: list[FrameWindow], track: Track, rates: Array, rows: NDArray[np.int64]
) -> Array | None:
    """The texture (faces, n, n) of frames with their own poses, NaN where nothing is known; None if no face has marks."""
    turned, n = matrix_from_quat(track.quaternion[rows]), len(rows)
    poses = FlightPoses(track.position_m[rows], turned, rates[rows, :3], rates[rows, 3:], np.zeros((n, 6, 0)))
    marks = with_learned_textures(view, windows, poses, unlearned_marks(view, grid, np.inf, ()), CUTS[0])
    return marks.texture if len(marks.marked_faces) else None


def _same_marks(grid: FaceGrid, shown: Array, texture: Array, symmetries: Array) -> Array | None:
    """The symmetry after which a texture (faces, n, n) shows the marks of another; None if none is clearly better than all
    others."""
    turned = [_relabelled(grid, texture, symmetry) for symmetry in symmetries]
    common = np.array([(np.isfinite(shown) & np.isfinite(one)).sum() for one in turned])
    enough = common >= max(LEAST_SHARED * common.max(), FEWEST_MARKED_TEXELS)
    found = np.array([_correlation(shown, one) if use else -1.0 for one, use in zip(turned, enough, strict=True)])
    order = np.argsort(-found)
    best, next_best = found[order[:2]].tolist()
    if best < SAME_MARKS_CORRELATION or 1.0 - best**2 > DISTINCT_UNEXPLAINED * (1.0 - max(next_best, 0.0) ** 2):
        return None
    return np.asarray(symmetries[order[0]], float)


def _relabelled(grid: FaceGrid, texture: Array, symmetry: Array) -> Array:
    """A texture (faces, n, n) on the faces of a die that is labelled anew: what lay at S x in body axes lies at x, for a symmetry
    S (3, 3). Texels outside what is known are NaN."""
    half, out = 0.5 * (grid.size - 1), np.full_like(texture, np.nan)
    b, a = np.mgrid[0 : grid.size, 0 : grid.size] - half
    for f, axes in enumerate(grid.axes):
        other = int(np.argmax(grid.axes[:, 2] @ (symmetry @ axes[2])))
        if not np.isfinite(texture[other]).any():
            continue
        turn = grid.axes[other, :2] @ symmetry @ axes[:2].T
        columns, rows = (turn[i, 0] * a + turn[i, 1] * b + half for i in (0, 1))
        out[f] = map_coordinates(texture[other], [rows, columns], order=1, mode="constant", cval=np.nan)
    return out


def _correlation(one: Array, other: Array) -> float:
    """Correlation of two textures (faces, n, n) over what both show, each face about its mean."""
    products = np.zeros(3)
    for a, b in zip(one, other, strict=True):
        both = np.isfinite(a) & np.isfinite(b)
        if both.sum() > 1:
            p, q = a[both] - a[both].mean(), b[both] - b[both].mean()
            products += p @ q, p @ p, q @ q
    return float(products[0] / np.sqrt(max(products[1] * products[2], 1e-300)))
