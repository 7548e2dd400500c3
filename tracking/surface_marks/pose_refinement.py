"""Single frames refined on surface marks and edges together.

Normal equations of marks and edges are added. The edges enter with the common error that the bundle adjustment
estimated for them: a flight's frames together have it once. What then remains is mostly common to all frames of a
clip, the placement of the textures on the body. It is part of the covariance of `SurfaceMarks.flights`, and
`shared_covariances` gives it by itself; the information of a refined frame is about that frame's own pixels alone.

Pose increments are (δp, δθ): world position [m], and rotation vector in world axes [rad], R_true = exp(δθ) R.
"""

from __future__ import annotations

from concurrent.futures import Executor, Future
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import matrix_from_quat
from ...model.throw import Throw
from ..flights import transition_matrices
from ..picture import BIWEIGHT_CUT, THREADS, View
from ..pose import weak_priors
from .bundle_adjustment import contour_covariance, rotation_vectors
from .mark_equations import RefinedRows, refine_rows
from .textures import SurfaceMarks, faces_of, optics_of

Array = NDArray[np.float64]

PLACEMENT_PX = 0.005
"""Standard deviation of where a picture shows a mark: oblique light on its border, the shape of a pixel and the
curvature of a sensor shift it by some thousandths of a pixel, equally on all frames."""
PLACEMENT_SHARE = 0.002
"""Additional standard deviation for a rounded die, as a share of the corner radius: its edges are located less
accurately, and textures are placed on faces from poses by edges."""
WINDOW_PX = 6.0
"""Margin of a frame's window about the outline."""
FLIGHT_CONTRADICTED = 30.0
"""Squared distance [sigmas, six degrees of freedom] of a frame's edges from the flight from which the refinement does
not start on the flight: it might converge to other marks."""
OUTSIDE_PX = -1e6
"""Stands for the pixel of a corner behind the camera: its window is empty."""


@dataclass(frozen=True, eq=False)
class FramePoses:
    """Poses of single frames, from edges alone or from marks and edges, one row each."""

    position_m: Array
    """(n, 3)"""
    rotation: Array
    """(n, 3, 3) body to world."""
    information: Array
    """(n, 6, 6) inverse covariance from the pixels of each frame alone. With marks, the edges' common error in a
    flight enters multiplied by the number of its frames, so that all frames together contain it once."""
    bias_jacobian: Array
    """(n, 6, k) derivative of each pose by errors that all frames share, see `Track`."""


class FrameRefinement:
    """The refinement of frames on marks and edges together.

    All that does not depend on the pictures is computed for all frames at once; the pictures then come block by block.
    """

    def __init__(self, view: View, marks: SurfaceMarks, edges: FramePoses, throw: Throw, times_s: Array) -> None:
        """Prepare the frames at `times_s` (n,), whose poses by edges are `edges`.

        Their refinement starts on `throw`, the adjusted flights with their impacts, or at the edges' pose where
        nothing was learned on a flight or the edges contradict it by FLIGHT_CONTRADICTED.
        """
        n = len(times_s)
        flight, shared = throw.flights_at(times_s), np.empty((n, 6, 6))
        for k in np.unique(flight):
            shared[flight == k] = shared_covariances(view, marks, int(k), times_s[flight == k])
        velocity, omega = (np.ascontiguousarray(half) for half in np.split(throw.rates(times_s), 2, axis=1))
        position, quaternion = throw.poses(times_s)
        learned = np.asarray(np.isfinite(shared[:, 0, 0]))
        rotation = matrix_from_quat(quaternion)
        difference = np.concatenate([edges.position_m - position, rotation_vectors(rotation, edges.rotation)], axis=1)
        alone = edge_information(view, marks, edges, np.ones(n))
        squared = np.einsum("ni,nij,nj->n", difference, alone, difference)
        by_flight = learned & (squared < FLIGHT_CONTRADICTED)
        # The edges' common error in a flight is shared by its frames.
        sharing = np.where(learned, np.bincount(flight[learned], minlength=len(throw.flights))[flight], 1)
        information = edge_information(view, marks, edges, sharing)
        difference[~by_flight] = 0.0
        self._rows = RefinedRows(
            position=np.where(by_flight[:, None], position, edges.position_m),
            rotation=np.where(by_flight[:, None, None], rotation, edges.rotation),
            velocity=velocity,
            omega=omega,
            edge_information=information,
            edge_gradient=np.einsum("nij,nj->ni", information, difference),
            mark_information=np.zeros((n, 6, 6)),
        )
        self._view, self._edges, self._variance_factor = view, edges, marks.variance_factor
        self._optics, self._faces = optics_of(view, marks), faces_of(view, marks, BIWEIGHT_CUT)
        self.boxes = _windows(view, self._rows.position, self._rows.rotation)
        """(n, 4) pixels x0, y0, x1, y1 (end exclusive) of the first camera that are used."""
        self.shared_covariance = shared
        """(n, 6, 6) that each pose shares with all others (`shared_covariances`)."""

    def refine(self, frames: NDArray[Any], which: NDArray[np.int64], rows: slice, pool: Executor) -> list[Future[None]]:
        """Refine some rows in the threads of a pool: those of pictures number `which` (m,) of `frames` (n, cameras,
        height, width). Returns the jobs, which must be done before `poses` is called."""

        def refine_part(first: int, end: int) -> None:
            mine = slice(rows.start + first, rows.start + end)
            part = RefinedRows(*(array[mine] for array in self._rows))
            boxes = self.boxes[mine]
            refine_rows(frames, which[first:end], boxes, self._optics, self._faces, self._variance_factor, part)

        cuts = np.linspace(0, len(which), THREADS + 1).astype(int).tolist()
        return [pool.submit(refine_part, first, end) for first, end in pairwise(cuts) if end > first]

    def poses(self) -> FramePoses:
        """The refined poses. A frame without a marked face in view keeps the edges' pose, its information reduced by
        the edges' common error."""
        rows = self._rows
        unseen = np.asarray(~rows.mark_information.any(axis=(1, 2)))
        position = np.where(unseen[:, None], self._edges.position_m, rows.position)
        rotation = np.where(unseen[:, None, None], self._edges.rotation, rows.rotation)
        information = rows.mark_information + rows.edge_information
        # Marks do not depend on the contour: the pose inherits its error by the edges' share of the information.
        share = rows.edge_information @ self._edges.bias_jacobian
        bias_jacobian = np.linalg.solve(information + weak_priors(self._view, position), share)
        return FramePoses(position, rotation, information, bias_jacobian)


def edge_information(view: View, marks: SurfaceMarks, edges: FramePoses, sharing: NDArray[Any]) -> Array:
    """(n, 6, 6) information of poses by edges. Their common error enters multiplied by the number of frames `sharing`
    (n,) it, so that all of those together are not more accurate than it allows."""
    common = sharing[:, None, None] * contour_covariance(view, edges.position_m, marks.contour_m)
    # (Σ + S)⁻¹ from the information Σ⁻¹, which may be singular.
    return np.asarray(edges.information @ np.linalg.inv(np.eye(6) + common @ edges.information))


def shared_covariances(view: View, marks: SurfaceMarks, flight: int, times_s: Array) -> Array:
    """(n, 6, 6) covariance that all frames share, of the poses at `times_s` (n,) on a flight.

    It comes from the uncertain placement of the textures, from what contradicts the edges (`placement_m`), and from
    PLACEMENT_PX and PLACEMENT_SHARE, which no frame shows. It adds to the covariance of any fit of many frames, because
    it does not shrink with their number. NaN in a flight from which nothing was learned.
    """
    M = transition_matrices(marks.flights[flight], times_s)[:, :6]
    position_m, _ = marks.flights[flight].poses(times_s)
    pixels_m = PLACEMENT_PX / view.camera.matrix[0, 0] * np.linalg.norm(position_m - view.camera.centre_m, axis=1)
    placement_m2 = pixels_m**2 + (PLACEMENT_SHARE * view.die.corner_radius_m) ** 2 + marks.placement_m**2
    placement = placement_m2[:, None, None] * contour_covariance(view, position_m, 1.0)
    return np.asarray(M @ marks.shared_covariance[flight] @ np.swapaxes(M, 1, 2) + placement)


def _windows(view: View, positions_m: Array, rotations: Array) -> NDArray[np.int64]:
    """(n, 4) pixel windows x0, y0, x1, y1 (end exclusive) round a die at poses (n, 3), (n, 3, 3); empty outside the
    picture."""
    corners = np.einsum("nij,vj->nvi", rotations, view.die.solid.vertices) + positions_m[:, None]
    px, camera = view.camera.project(corners), view.camera
    good = np.asarray(np.isfinite(px).all(axis=(1, 2)))
    px = np.where(good[:, None, None], px, OUTSIDE_PX)
    size = np.array([camera.width_px, camera.height_px])
    low = np.clip(np.floor(px.min(1) - WINDOW_PX), 0, size)
    high = np.clip(np.ceil(px.max(1) + WINDOW_PX) + 1, 0, size)
    return np.concatenate([low, high], axis=1).astype(np.int64)
