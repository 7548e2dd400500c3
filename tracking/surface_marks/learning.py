"""The die's own marks as features of its pose: pips, numbers, grain, whatever its faces show.

A rounded or shaded edge lies where no model of a sharp edge expects it, and it does so alike on every frame, so that no
averaging helps. What is printed on a flat face has no such error: the plane of the face is known to a part in a thousand
from the die's size, whatever its edges look like. The appearance of each face is learned from the clip itself.

1. *Learning* (`marks_textures`). From the flights of a first track, chosen frames are brought onto a grid of face
   coordinates; the grey of frame k on face f is modelled as

       I = (c + c_a a + c_b b) T_f(a, b) + p + p_a a + p_b b

   with T_f the texture (about one on bare paint) and six numbers of light for each face and frame, fitted robustly
   (Tukey's biweight), so that glare, shadow and whatever hides the die drop out. T_f is the mean of what the frames show,
   each weighted by its contrast, its noise and the squared cosine of its view.
2. *Signal.* Even and odd frames give two textures whose noise is independent. Marks are where the product of their slopes
   exceeds what noise leaves in the mean by SIGNAL; a plain face has none and costs nothing from there on.
3. *Adjustment* (`marks_adjustment`). The textures were placed by the poses that they are meant to improve, so that an
   error which all poses share is learned along with them. It shows as soon as the die turns: a texture placed wrongly on
   its face does not follow the turn of a rigid body about its centre. Flights that meet at their bounces, for every face
   the ways in which its texture may be warped, and the lens blur are adjusted together (bundle adjustment, Gauss-Newton),
   edges entering as weak observations; then the textures are learned again from the adjusted flights. Size, and with it
   distance, comes from the known distance of the faces from the centre about which the die turns, from gravity, and from
   the table that the die's corners strike.
4. *Refinement.* A frame's residual is taken on its own pixels, never on resampled ones, so that their noise stays
   independent; the light is eliminated by a Schur complement (variable projection). Marks and edges are added up, the
   edges with the common error that the adjusted flights have shown them to have, of which the frames of a flight tell
   together no more than one.

A face seen aslant is blurred more along its short side, which makes a round mark seem longer there than it is; at a blur of
half a pixel this alone turned dice by 0.2 degrees. Each frame is therefore compared with the texture at the frame's own
blur, motion during the exposure included.

What is left after all this is mostly common to all frames of a clip: where the textures sit on the body. It is part of the
covariance of `Marks.flights` and stands by itself in `shared_covariances`; the information of a refined single frame is
about that frame's own pixels alone.

Pose increments are (δp, δθ): world position [m], and rotation vector in world axes [rad], R_true = exp(δθ) R.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import matrix_from_quat
from ...model.throw import Throw
from ..picture import THREADS, View, outline_box
from ..pose import weak_prior
from ..throw import VertexImpact, transition_matrices
from ..track import Track
from .bundle_adjustment import adjusted, bounces_between, contour_covariance, turn_between
from .kernel_types import TUKEY
from .refine_kernels import refine_on_marks
from .textures import FEWEST_LOOKS, Look, Marks, blank_marks, face_grid, faces_of, optics_of, with_learned_textures
from .textures import FaceGrid as FaceGrid

Array = NDArray[np.float64]

LOOKS = 120
"""Frames learned from at the most: the texture's noise is then a tenth of one frame's, and the cost does not grow with
the clip."""
SHORT_FLIGHT = 10
"""Frames of a flight below which all are looked at."""
CUTS = (8.0 * TUKEY, 3.0 * TUKEY, 1.5 * TUKEY, TUKEY, TUKEY, TUKEY, TUKEY)
"""Cut of the robust weights [sigmas] in each round of adjusting and learning again. A narrow cut from the start would take what
the first poses misplaced for something that hides the die. The rounds with wide cuts see half of the looks."""
SETTLED_SIGMAS = 0.5
"""A round that moves no flight by more than this many of its sigmas is the last of its kind, with a wide cut or the last one: the
next would move it by a third of that."""
WILD_SIGMAS = 6.0
"""A flight that moves by more, once the cut is narrow, is no flight: a die that rolls or slides does not fall, and pulls at its
neighbours from round to round. Flights that are some move by two or three sigmas there at the most."""
NEAR_BOUNCE = 1.0
"""Frames from an impact within which a frame teaches nothing: its exposure may straddle it."""
PLACED_PX = 0.005
"""One sigma of where a picture has a mark: light that falls aslant on its border, the form of a pixel, the curve of a
sensor move it by some thousandths of a pixel, on all frames alike."""
PLACED_SHARE = 0.002
"""The same of a rounded die, as a share of the corners' radius, besides: where its edges are is seen less well, and marks are
placed on its faces from where the edges put the die."""
WINDOW_PX = 6.0
"""Margin of a frame's window about the outline."""
STEPS = 4
"""Gauss-Newton steps of a refinement; from a flight the first one settles it to a hundredth of a pixel."""
FAR = 30.0
"""Squared sigmas of six numbers from which the edges of a frame do not show it on its flight: a step of the refinement that
begins there may lead to other marks."""


def frames_to_learn_from(track: Track, throw: Throw) -> NDArray[np.int64]:
    """Rows of the track, about LOOKS, spread evenly over the frames that surely lie on a flight; short flights are not
    thinned out."""
    spacing = float(np.median(np.diff(track.time_s))) if len(track) > 1 else 0.0
    bounces = np.array([impact.time_s for impact in throw.impacts])
    good = np.flatnonzero(track.tracked)
    if len(bounces):
        away = np.abs(track.time_s[good, None] - bounces).min(1)
        good = good[away > NEAR_BOUNCE * spacing]
    flight = throw.flights_at(track.time_s[good])
    chosen = []
    for k in np.unique(flight):
        mine = good[flight == k]
        share = int(np.ceil(LOOKS * len(mine) / len(good)))
        chosen.append(
            mine[np.unique(np.linspace(0, len(mine) - 1, min(len(mine), max(share, SHORT_FLIGHT))).round().astype(int))]
        )
    return np.concatenate(chosen) if chosen else good


def learn_marks(
    view: View,
    images: Iterable[tuple[int, NDArray[Any]]],
    track: Track,
    throw: Throw,
    strikes: Sequence[VertexImpact | None],
    *,
    saturation_grey: float = np.inf,
) -> Marks | None:
    """What the faces of the die look like, or None where no face shows anything that places it.

    `images` are pairs of a row of `track` and its whole frame (height, width), best those of `frames_to_learn_from`; only a
    window of each is kept. `track` holds poses of single frames from edges, `throw` the flights measured through them, and
    `strikes` (impacts,) what its impacts were. Pixels at `saturation_grey` and above are left out.
    """
    looks = _looks(view, images, track, throw)
    if len(looks) < 2 * FEWEST_LOOKS:
        return None
    grid = face_grid(view, looks, throw)
    bounces = bounces_between(looks, throw, strikes)
    few = _thinned(looks)
    marks = with_learned_textures(view, few, throw.flights, blank_marks(view, grid, saturation_grey, throw), CUTS[0])
    settled = False
    for cut in CUTS:
        wide = cut > TUKEY
        if wide and settled:
            continue
        if not len(marks.marked_faces):
            return None
        chosen = few if wide else looks
        marks, moved_sigmas = adjusted(view, chosen, bounces, marks, cut)
        if not wide and (moved_sigmas > WILD_SIGMAS).any():
            wild = moved_sigmas > WILD_SIGMAS
            marks, looks = _without_flights(marks, looks, wild, throw)
            # What it seemed to strike is as doubtful as the flight.
            bounces = [bounce for bounce in bounces if not wild[list(bounce.flights)].any()]
            chosen = looks
            if len(looks) < 2 * FEWEST_LOOKS:
                return None
        marks = with_learned_textures(view, chosen, marks.flights, marks, cut)
        settled = bool(moved_sigmas.max() < SETTLED_SIGMAS)
        if settled and not wide:
            break
    return marks if len(marks.marked_faces) else None


def _without_flights(
    marks: Marks, looks: list[Look], wild: NDArray[np.bool_], throw: Throw
) -> tuple[Marks, list[Look]]:
    """Marks and looks without the flights (flights,) that are `wild`, which are as the edges had them again."""
    flights = tuple(throw.flights[k] if wild[k] else flight for k, flight in enumerate(marks.flights))
    shared = tuple(np.full((12, 12), np.nan) if wild[k] else known for k, known in enumerate(marks.shared))
    looks = [look for look in looks if not wild[look.flight]]
    return replace(marks, flights=flights, shared=shared), looks


@dataclass(frozen=True, eq=False)
class FramePoses:
    """Poses of single frames, from edges alone or from marks and edges: one row each."""

    position_m: Array
    """(n, 3)"""
    rotation: Array
    """(n, 3, 3) body to world."""
    information: Array
    """(n, 6, 6) inverse covariance from the pixels of each frame alone; with marks, what edges err alike in a flight counts in
    it as often as the flight has frames, so that all together have it once."""
    contour_bias_jacobian: Array
    """(n, 6) [m/px, rad/px] by how much each is off for every pixel that the contour is taken too far out."""


class Refining:
    """Frames on their way from the poses that edges bear out to those that marks and edges bear out together.

    What there is to know before the pictures is worked out for all frames at once; the pictures then come block by block.
    """

    def __init__(self, view: View, marks: Marks, edges: FramePoses, throw: Throw, times_s: Array) -> None:
        """The frames at `times_s` (n,) belong to the poses `edges`. The steps begin where `throw`, the adjusted flights with
        their impacts, leads, or at the edges' pose where nothing was learned there, or where they lie FAR from it."""
        which, shared = throw.flights_at(times_s), np.empty((len(times_s), 6, 6))
        for k in np.unique(which):
            shared[which == k] = shared_covariances(view, marks, int(k), times_s[which == k])
        velocity, omega = (np.ascontiguousarray(half) for half in np.split(throw.rates(times_s), 2, axis=1))
        position, quaternion = throw.poses(times_s)
        learned = np.asarray(np.isfinite(shared[:, 0, 0]))
        turn = matrix_from_quat(quaternion)
        away = np.concatenate([edges.position_m - position, turn_between(turn, edges.rotation)], axis=1)
        alone = edge_information(view, marks, edges, np.ones(len(times_s)))
        by_flight = learned & (np.einsum("ni,nij,nj->n", away, alone, away) < FAR)
        # What edges get wrong alike in a flight is told once: its frames share that between them.
        sharing = np.where(learned, np.bincount(which[learned], minlength=len(throw.flights))[which], 1)
        self._sure = edge_information(view, marks, edges, sharing)
        self._position = np.where(by_flight[:, None], position, edges.position_m)
        self._rotation = np.where(by_flight[:, None, None], turn, edges.rotation)
        away[~by_flight] = 0.0
        self._pull, self._H = np.einsum("nij,nj->ni", self._sure, away), np.zeros((len(times_s), 6, 6))
        self._rates = velocity, omega
        self._view, self._edges, self._factor = view, edges, marks.factor
        self._optics, self._faces = optics_of(view, marks), faces_of(view, marks, TUKEY)
        self.boxes = _windows(view, self._position, self._rotation)
        """(n, 4) pixels x0, y0, x1, y1 (end exclusive) of the first camera that are looked at."""
        self.shared = shared
        """(n, 6, 6) covariance that each pose shares with all others (`shared_covariances`)."""

    def see(self, frames: NDArray[Any], which: NDArray[np.int64], rows: slice, pool: Executor) -> list[Future[None]]:
        """Refine some rows: those of pictures number `which` (m,) of some (n, cameras, height, width), in the threads of a pool.
        The jobs that were begun, which must be done before `poses` is asked."""

        def some(a: int, b: int) -> None:
            mine = slice(rows.start + a, rows.start + b)
            velocity, omega = self._rates
            refine_on_marks(
                frames, which[a:b], self.boxes[mine], self._optics, self._faces, self._position[mine], self._rotation[mine],
                velocity[mine], omega[mine], self._factor, self._sure[mine], self._pull[mine], STEPS, self._H[mine],
            )  # fmt: skip

        cuts = np.linspace(0, len(which), THREADS + 1).astype(int).tolist()
        return [pool.submit(some, a, b) for a, b in pairwise(cuts) if b > a]

    def poses(self) -> FramePoses:
        """Where they are now. Where no marked face was seen, the edges' pose stays, its covariance widened by their systematic
        errors as often as frames share them."""
        unseen = np.asarray(~self._H.any(axis=(1, 2)))
        position = np.where(unseen[:, None], self._edges.position_m, self._position)
        rotation = np.where(unseen[:, None, None], self._edges.rotation, self._rotation)
        information = self._H + self._sure
        # The marks know nothing of the contour: of its error the pose takes the edges' part of the information.
        part = np.einsum("nij,nj->ni", self._sure, self._edges.contour_bias_jacobian)
        lean = np.linalg.solve(information + weak_prior(self._view), part[..., None])[..., 0]
        return FramePoses(position, rotation, information, lean)


def edge_information(view: View, marks: Marks, edges: FramePoses, sharing: NDArray[Any]) -> Array:
    """(n, 6, 6) of poses from edges. What they get wrong in common counts as often as there are frames `sharing` (n,) it, so
    that all of these together know the pose no better than it lets them."""
    common = sharing[:, None, None] * contour_covariance(view, edges.position_m, marks.contour_m)
    # (Σ + S)⁻¹ by way of the information, which may be singular where Σ does not exist.
    return np.asarray(edges.information @ np.linalg.inv(np.eye(6) + common @ edges.information))


def shared_covariances(view: View, marks: Marks, flight: int, times_s: Array) -> Array:
    """(n, 6, 6) of the poses at `times_s` (n,) that all frames share: what the uncertain places of the textures do to every
    one of them, and what no frame can show, PLACED_PX and PLACED_SHARE. It belongs on top of whatever a fit of many frames says,
    because it does not shrink with their number. NaN in a flight from which nothing was learned."""
    M = transition_matrices(marks.flights[flight], times_s)[:, :6]
    places_m, _ = marks.flights[flight].poses(times_s)
    seen_m = PLACED_PX / view.camera.matrix[0, 0] * np.linalg.norm(places_m - view.camera.centre_m, axis=1)
    placed_m = np.hypot(seen_m, PLACED_SHARE * view.die.corner_radius_m)
    placed = placed_m[:, None, None] ** 2 * contour_covariance(view, places_m, 1.0)
    return np.asarray(M @ marks.shared[flight] @ np.swapaxes(M, 1, 2) + placed)


def _windows(view: View, positions_m: Array, rotations: Array) -> NDArray[np.int64]:
    """(n, 4) pixel windows x0, y0, x1, y1 (end exclusive) round the dice as placed; empty where one lies outside."""
    corners = np.einsum("nij,vj->nvi", rotations, view.die.solid.vertices) + positions_m[:, None]
    px, camera = view.camera.project(corners), view.camera
    good = np.asarray(np.isfinite(px).all(axis=(1, 2)))
    px = np.where(good[:, None, None], px, -1e6)
    size = np.array([camera.width_px, camera.height_px])
    low = np.clip(np.floor(px.min(1) - WINDOW_PX), 0, size)
    high = np.clip(np.ceil(px.max(1) + WINDOW_PX) + 1, 0, size)
    return np.concatenate([low, high], axis=1).astype(np.int64)


def _looks(view: View, images: Iterable[tuple[int, NDArray[Any]]], track: Track, throw: Throw) -> list[Look]:
    """Windows round the die on the frames of flights that have enough of them."""
    looks = []
    for row, image in images:
        time_s = float(track.time_s[row])
        flight = throw.flight_at(time_s)
        state = throw.flights[flight].at(time_s)
        box = outline_box(view, state.position_m, state.rotation, WINDOW_PX)
        if box is None or not track.tracked[row]:
            continue
        x0, y0, x1, y1 = box
        window = np.ascontiguousarray(image[y0:y1, x0:x1], np.float32)
        looks.append(
            Look(time_s, flight, x0, y0, window, track.position_m[row], track.quaternion[row], track.covariance[row])
        )
    counts = np.bincount([look.flight for look in looks], minlength=len(throw.flights))
    return [look for look in looks if counts[look.flight] >= 2]


def _thinned(looks: list[Look]) -> list[Look]:
    """Every second look, and all of short flights: enough to come near, in half the time."""
    counts = np.bincount([look.flight for look in looks])
    return [look for i, look in enumerate(looks) if i % 2 == 0 or counts[look.flight] <= SHORT_FLIGHT]
