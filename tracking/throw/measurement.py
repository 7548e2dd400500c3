"""The throw that a track shows: flights, impacts, and the end on the table.

What follows the last flight on the table is set aside (`rest`), the remaining track is segmented into flights
(`flight_segmentation`), or followed from contact to contact (`contact_search`), and the contacts between the flights are
resolved (`contacts`); the chain of flights that explains the frames better remains. Each contact is then described by its
instant, its vertices and its restitution; several contacts that cannot be separated are one unresolved contact."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, inner_vertices, lowest_face
from ...model.errors import InputError
from ...model.rotations import angle_between, continuous_sign, cross_matrix, matrix_from_quat, quat_from_matrix
from ...model.throw import Flight, Impact, State, Throw, energy_J
from ..camera import Camera
from ..covariance import covariance_root
from ..flights import TABLE_SIGMA_M, FlightChain, Link, WeightedPoses, rms_residuals
from ..track import Track
from .calibration_errors import EXACT, CalibrationErrors, CalibrationEstimate, unknown_errors
from .contact_clusters import instant_limit_s
from .contact_search import ContactSearch, follow_contacts, white_errors
from .contacts import (
    INCONSISTENT_SIGMAS,
    KNOWN_FLIGHT_SHARE,
    UNKNOWN_TABLE_M,
    Priors,
    ResolvedChain,
    explains_better,
    join_flights,
    normal_velocity,
    normal_velocity_jacobian,
    resolve_contacts,
    vertex_impacts,
)
from .flight_segmentation import MIN_FRAMES, contact_reach_m, decimation_factor, rows_without_outliers, segment_flights
from .rest import SupportedMotion, first_low_row, first_supported_row, on_table, resting_vertices
from .shared_bias import (
    determined_count,
    shared_bias_jacobian,
    shared_bias_sigma,
    undetermined_bias_sigma,
    without_shared_bias,
)
from .smoothing import smooth

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

UNMODELLED_SHARE = 0.1
"""Factor on the unmodelled pose error (`WeightedPoses.from_poses`) where an error model is estimated: it bounds the weight of a
frame that states no error."""
WIDER_SIGMAS = 4.0
"""Factor on the frames' sigmas for a second segmentation. Contacts close to each other are opened, joined and removed one after
the other, and little decides which: where that fails with sigmas of one size, it may succeed with another."""
MAX_LINKS_TWICE = 12
"""Links beyond which a chain is not segmented twice: a die that bounces until it rattles to rest leaves doubts with any sigmas,
and hypotheses on its contacts take most of the time."""
FEW_OUTLIERS = 0.05
"""Share of frames on no flight up to which a chain leaves no doubt: some lie beside impacts."""
BELIEVED_SHARE = 0.5
"""Share of its frames above which a flight is believed."""
OWN_MOTION_FRAMES = 6
"""Frames off a flight at an end of the track, one after the other, from which they count as a motion of their own: outliers come
a few in a row."""
OFF_FLIGHT_RAD = 0.2
"""Angle [rad] from a flight at which a frame does not lie on it, whatever the errors of its pose, nor takes its labelling."""
SAME_LABEL = 1e-6
"""Difference of matrix elements up to which a label is the same; those of two symmetries differ by 0.5 or more."""
DRAWS = 2000
"""Random draws behind the interval of a restitution."""
SEED = 20120404
"""Seed of those draws."""
INTERVAL_PERCENT = (2.5, 97.5)
"""Ends of a 95 % interval."""


class NoFlightError(InputError):
    """The track holds no flight that could be measured."""


@dataclass(frozen=True, eq=False)
class MeasuredThrow:
    """A throw measured from single frames, and what was estimated of the frames on the way."""

    throw: Throw
    frames: Track
    """The single frames, labelled as the flights are, with the estimated shared errors subtracted."""
    frames_on_table: Track
    """The same with the frames of a die that the table supports corrected to lie on it."""
    resolved: ResolvedChain
    """The chain of flights, and the frames and priors that it was fitted with."""
    rows: NDArray[np.int64]
    """(n,) rows of the track that the flights were fitted to."""
    shared_covariance: Array
    """(track rows, 6, 6) covariance of the pose errors that all frames share and that the motion does not determine; contained in
    the covariances of `throw`."""
    throw_without_shared_errors: Throw
    """The throw with covariances that do not contain these."""
    die: Die
    labels: Array
    """(track rows, 3, 3) the symmetries by which `frames` are labelled anew: R of the track becomes R times this."""
    calibration: CalibrationEstimate
    """What the throw shows of the errors of cameras, die and clock; the covariances of flights contain what it leaves open."""

    @property
    def chain(self) -> FlightChain:
        """The flights and what links them."""
        return self.resolved.chain

    @property
    def independent_frames(self) -> Track:
        """`frames_on_table` with covariances for a fit that takes frames as independent: a mean over a flight then has its true
        uncertainty. What a model is fitted to, together with the errors of cameras, die and clock."""
        independent = _independent(self.frames_on_table, self.throw, self.chain, self.shared_covariance)
        errors = self.calibration.errors
        return replace(independent, shared_errors=errors if errors.sources else None, unexplained=self.unexplained)

    @property
    def smoothed_frames(self) -> Track:
        """`frames_on_table` with the poses in flight smoothed by the motion, and covariances that contain the shared errors."""
        frames = self.calibration.at_frames(self.frames_on_table)
        frames = replace(frames, covariance=frames.covariance + self.calibration.pose_covariances)
        smoothed = smooth(frames, self.throw_without_shared_errors, self.shared_covariance, self.unexplained)
        return replace(smoothed, time_s=self.frames_on_table.time_s)

    @property
    def residual_sigmas(self) -> Array:
        """(track rows,) for each frame the residual standard deviation of its flight: the rms distance of the frames on it, in
        standard errors that their pictures state. NaN for frames that belong to no flight."""
        out, time_s = np.full(len(self.frames), np.nan), self.frames.time_s
        used = weighted_poses(self.frames, self.rows, UNMODELLED_SHARE)
        which = np.searchsorted(self.chain.link_times_s, time_s)
        for k, part in enumerate(self.chain.parts(used.time_s)):
            inliers = np.arange(part.start, part.stop)[self.chain.weights[part] > 0.0]
            if len(inliers) >= MIN_FRAMES:
                residuals = rms_residuals(used.rows(inliers), self.chain.flights[k].start)
                out[which == k] = np.sqrt(np.mean(residuals**2))
        return out

    @property
    def unexplained(self) -> NDArray[np.bool_]:
        """(track rows,) frames that no flight explains: those of flights that are not believed, tracked or not; those that lie on
        neither flight beside a contact that is not resolved; and those off the first or last flight, beyond all that lie on it,
        where they are many, or the table is so near that a contact may lie between."""
        time_s = self.frames.time_s
        used_s, used_q = time_s[self.rows], self.frames.quaternion[self.rows]
        which = np.searchsorted(self.chain.link_times_s, time_s)
        out = (time_s < self._held_s) & ~_believed(used_s, used_q, self.chain)[which]
        for impact in self.throw.impacts:
            if impact.contact in ("unresolved", "held"):
                out[self._off_flights_about(impact.time_s)] = True
        for end_s in (-np.inf, np.inf):
            rows = self._off_flights_about(end_s)
            if len(rows) >= OWN_MOTION_FRAMES or self._may_touch_table(rows):
                out[rows] = True
        return out

    @property
    def _held_s(self) -> float:
        """When the table begins to support the die; infinite if it does not."""
        return min((impact.time_s for impact in self.throw.impacts if impact.contact == "held"), default=np.inf)

    def _off_flights_about(self, at_s: float) -> NDArray[np.int64]:
        """Rows of the frames in flight between the last that lies on its flight before an instant and the first after it; none
        if these are neighbours among the frames that were used."""
        time_s, tracked = self.frames.time_s, np.flatnonzero(self.frames.tracked)
        tracked = tracked[time_s[tracked] < self._held_s]
        on_flight = np.searchsorted(tracked, self.rows[self.chain.weights > 0.0])
        # A frame at the very instant belongs to the flight before.
        after = int(np.searchsorted(time_s[tracked[on_flight]], at_s, side="right"))
        begin = int(on_flight[after - 1]) + 1 if after > 0 else 0
        end = int(on_flight[after]) if after < len(on_flight) else len(tracked)
        every = int(np.median(np.diff(np.searchsorted(tracked, self.rows)))) if len(self.rows) > 1 else 1
        return tracked[begin:end] if end - begin >= every else tracked[:0]

    def _may_touch_table(self, rows: NDArray[np.int64]) -> bool:
        """Whether the flights, continued over some rows of the track, come near the table there."""
        p, q = self.throw_without_shared_errors.poses(self.frames.time_s[rows])
        heights = p[:, 2] + (matrix_from_quat(q) @ self.die.solid.vertices.T)[:, 2].min(axis=1)
        return bool((heights < contact_reach_m(self.die)).any())


def measure_throw(track: Track, die: Die, camera: Camera | None = None, *, every: int = 1) -> Throw:
    """Flights with covariance and impacts with their uncertainty, from the poses of single frames.

    With the camera, the errors that all poses share are estimated. What follows the last flight, where the die rolls or rests, is
    an impact `held` and a flight without covariance (`SupportedMotion`). The flights are fitted to one in `every` tracked frames.
    Raises NoFlightError if fewer than three of those in a row are tracked."""
    return measure(track, die, camera, every=every).throw


def measure(
    track: Track, die: Die, camera: Camera | None = None, *, known: CalibrationErrors | None = None, every: int = 1
) -> MeasuredThrow:
    """As `measure_throw`, with what was estimated of all frames. The errors of cameras, die and clock that are `known` only so
    far are estimated too; left out, these are exact."""
    use = _usable_rows(track, die, every)
    bias_jacobian = unknown = np.zeros((len(track), 6, 0))
    observations = weighted_poses(track, use, UNMODELLED_SHARE)
    prior = sigma = undetermined = np.zeros(0)
    count = determined_count(track) if camera is not None else 0
    known = EXACT if known is None or camera is None else known
    calibration = unknown_errors(known, track, die)
    if camera is not None:
        bias_jacobian = shared_bias_jacobian(track, camera, die)
        sigma, undetermined = shared_bias_sigma(track, camera, die), undetermined_bias_sigma(track, camera, die)
        unknown = np.concatenate([bias_jacobian[:, :, :count], calibration.errors.jacobian], axis=2)
        prior = np.append(sigma[:count], np.ones(len(calibration.errors.sources)))
        observations = observations.with_bias_jacobian(unknown[use])
    # The test for free fall uses calibrated covariances if there are any: unlike the fits, it estimates no error model.
    stated = (
        observations
        if track.pixel_covariance is None
        else weighted_poses(replace(track, pixel_covariance=None), use, UNMODELLED_SHARE)
    )
    flying = first_supported_row(stated, die)
    _require_flight(flying)
    priors = Priors(prior, TABLE_SIGMA_M if camera else UNKNOWN_TABLE_M)
    found, impacts, flying = _flights_and_impacts(track, observations, use, flying, die, priors, count)
    labels = _labels(track, use[:flying], found.observations.quaternion)
    track, chain = _labelled_anew(track, labels), found.chain
    flights = chain.flights
    # The contour of a supported die lies amid its shadow: flights do not determine its error. Nor do flights that do not meet.
    left_out = len(prior) - len(chain.shared)
    is_determined = (np.arange(len(use)) < flying) & (left_out == 0) & (len(prior) > 0)
    left = np.where(is_determined[:, None], undetermined, sigma)
    shared_covariance = _shared_covariance(track, bias_jacobian, left, use, flying)
    # A chain none of whose flights is believed knows nothing of the errors that frames share.
    in_flight = use[:flying]
    believed = _believed(track.time_s[in_flight], track.quaternion[in_flight], chain)
    shared = chain.shared if believed.any() else np.zeros_like(chain.shared)
    own = slice(count - left_out, None) if left_out <= count else slice(0, 0)
    shown = shared[own] if believed.any() else shared[:0]
    estimate = CalibrationEstimate.of(calibration, known, shown, chain.shared_covariance[own, own])
    subtracted = np.append(shared[: own.start], estimate.errors.subtracted)[: len(shared)]
    straight = without_shared_bias(track, unknown[:, :, left_out:], subtracted)
    resting = straight
    if flying < len(use):
        if camera is not None and determines_table_height(chain):
            supported = track.tracked & (track.time_s >= track.time_s[use[flying]])
            resting = on_table(straight, np.flatnonzero(supported), die, chain.table_m, TABLE_SIGMA_M)
        poses, last_s = weighted_poses(resting, use[flying:]), float(observations.time_s[flying - 1])
        flights, impacts = _with_supported_motion(flights, impacts, poses, last_s, die)
    without = Throw(flights, impacts)
    throw = _with_shared_covariance(without, track.time_s[use[:flying]], shared_covariance[use[:flying]])
    measured = MeasuredThrow(
        throw, straight, resting, found, use[:flying], shared_covariance, without, die, labels, estimate
    )
    # Flights determine nothing of frames that none of them explains: the contour of a die that rocks lies amid its shadow too.
    undetermined_covariance = _shared_covariance(track, bias_jacobian, np.broadcast_to(sigma, left.shape), use, flying)
    unexplained = measured.unexplained[:, None, None]
    return replace(measured, shared_covariance=np.where(unexplained, undetermined_covariance, shared_covariance))


def _usable_rows(track: Track, die: Die, every: int) -> NDArray[np.int64]:
    """One in `every` tracked rows, outliers left out. Raises NoFlightError if these are too few."""
    use = np.flatnonzero(track.tracked)[::every]
    if len(use) < MIN_FRAMES:
        raise NoFlightError(f"{_frames(len(use))} tracked: wanted at least three in a row to measure a flight")
    tracked, use = len(use), use[rows_without_outliers(weighted_poses(track, use), die)]
    if len(use) < MIN_FRAMES:
        raise NoFlightError(
            f"{_frames(tracked)} tracked, and {len(use)} of them move as a die can: wanted at least three in a row to measure "
            "a flight"
        )
    return use


def _require_flight(frames: int) -> None:
    """Raises NoFlightError for fewer than MIN_FRAMES in flight."""
    if frames < MIN_FRAMES:
        raise NoFlightError(f"{frames} frames show the die in flight: wanted at least three in a row")


def _frames(count: int) -> str:
    return "1 frame is" if count == 1 else f"{count} frames are"


def _labels(track: Track, use: Rows, quaternion: Array) -> Array:
    """The labels (track rows, 3, 3) that make others (n, 4) of the orientations of the rows in use; the other rows take those of
    the nearest."""
    own = np.swapaxes(matrix_from_quat(track.quaternion[use]), 1, 2) @ matrix_from_quat(quaternion)
    if np.allclose(own, np.eye(3), atol=SAME_LABEL):
        return np.tile(np.eye(3), (len(track), 1, 1))
    return np.asarray(own[_nearest_of(use, len(track))])


def _labelled_anew(track: Track, labels: Array) -> Track:
    """The track with its labels changed by (track rows, 3, 3); itself where they stay."""
    if (labels == np.eye(3)).all():
        return track
    quaternion, rows = track.quaternion.copy(), np.flatnonzero(track.tracked)
    quaternion[rows] = quat_from_matrix(matrix_from_quat(quaternion[rows]) @ labels[rows])
    return replace(track, quaternion=continuous_sign(quaternion))


def _flights_and_impacts(
    track: Track, observations: WeightedPoses, use: Rows, flying: int, die: Die, priors: Priors, count: int
) -> tuple[ResolvedChain, tuple[Impact, ...], int]:
    """The chain of flights through the first `flying` of the rows in use, its impacts, and how many of the rows are in flight:
    fewer if the last impacts turn out to be part of coming to rest."""
    limit_s = instant_limit_s(observations.time_s)
    low = first_low_row(observations, die) if flying < len(use) else len(use)
    while True:
        # Segmentation uses fewer frames than the fit, where so many show the motion.
        ahead = slice(0, flying)
        every = decimation_factor(track, die, use[ahead])
        found = _resolved_chain(
            weighted_poses(track, use[ahead][::every]), observations.rows(ahead), die, priors, every
        ).without_undetermined_errors(count)
        believed = _believed(observations.time_s[ahead], found.observations.quaternion, found.chain)
        impacts = _impacts(found.chain, believed, die, limit_s)
        low_row = max(low, MIN_FRAMES)
        low_s = float(observations.time_s[low_row]) if low_row < flying else np.inf
        certain = _count_to_last_rebound(impacts, low_s)
        if certain == len(impacts):
            return found, impacts, flying
        # A fit may put the impact behind the last frame in flight: one frame less each time, or this would not end.
        flying = min(int(np.searchsorted(observations.time_s, impacts[certain].time_s)), flying - 1)
        _require_flight(flying)


def _resolved_chain(
    some: WeightedPoses, observations: WeightedPoses, die: Die, priors: Priors, every: int
) -> ResolvedChain:
    """The chain of flights through frames, segmented on `some`, one in `every` of them, or followed from contact to contact: the
    one that explains the frames better. If that leaves a doubt, a chain segmented with wider sigmas competes as well."""
    parts = segment_flights(some, die)
    found = resolve_contacts(observations, join_flights(some, parts, die), die, priors)
    followed = _followed(observations.rows(slice(None, None, every)), parts, die, priors)
    if followed is not None:
        other = resolve_contacts(observations, followed, die, priors)
        found = other if explains_better(observations, other, found) else found
    if _is_beyond_doubt(found, die) or len(found.chain.links) > MAX_LINKS_TWICE:
        return found
    wide = replace(some, whitener=some.whitener / WIDER_SIGMAS)
    other = resolve_contacts(observations, join_flights(wide, segment_flights(wide, die), die), die, priors)
    return other if explains_better(observations, other, found) else found


def _followed(some: WeightedPoses, parts: list[Rows], die: Die, priors: Priors) -> FlightChain | None:
    """The chain of flights followed from contact to contact; None where there are no `vertex_impacts`."""
    impacts = vertex_impacts(die)
    if not impacts or not parts:
        return None
    return follow_contacts(ContactSearch(some, die, impacts, parts, white_errors(some), priors))


def _is_beyond_doubt(found: ResolvedChain, die: Die) -> bool:
    """Whether every link is an impact (at a vertex, unless the centre of mass is elsewhere), most frames of each flight lie
    on it, and few frames lie on none. A flight without frames leaves a doubt."""
    chain = found.chain
    if any(link.is_open or (die.is_nearly_centred and link.impact is None) for link in chain.links):
        return False
    is_known = bool((chain.inlier_share(found.observations.time_s) >= KNOWN_FLIGHT_SHARE).all())
    return is_known and float((chain.weights == 0.0).mean()) < FEW_OUTLIERS


def _count_to_last_rebound(impacts: tuple[Impact, ...], low_s: float) -> int:
    """Number of impacts up to the last certain rebound, counting all before `low_s`.

    A certain rebound has a restitution surely above zero, and either surely below one or consistent with the median of the throw.
    A die that tips over seems to hop on and on: impacts behind the last certain rebound are part of coming to rest."""
    usual = float(np.nanmedian([impact.chi for impact in impacts])) if any(i.chi_low > 0.0 for i in impacts) else np.nan
    count = len(impacts)
    while count and impacts[count - 1].time_s >= low_s:
        last = impacts[count - 1]
        if last.chi_low > 0.0 and (last.chi_high < 1.0 or last.chi_low < usual < last.chi_high):
            break
        count -= 1
    return count


def determines_table_height(chain: FlightChain) -> bool:
    """Whether impacts determine the height of the table, and it is about where the scene has it."""
    has_impacts = any(link.impact is not None for link in chain.links)
    return has_impacts and abs(chain.table_m) < INCONSISTENT_SIGMAS * TABLE_SIGMA_M


# --- covariances -------------------------------------------------------------------------------------------------------


def weighted_poses(track: Track, use: NDArray[np.int64], unmodelled: float = 1.0) -> WeightedPoses:
    """Some rows of a track as the fits need them, with the covariance from the pixels of each frame.

    The fits estimate the error model and the shared errors themselves: covariances that contained them hid weak impacts of
    rounded dice. `unmodelled` is that of `WeightedPoses.from_poses`."""
    own = track.covariance if track.pixel_covariance is None else track.pixel_covariance
    return WeightedPoses.from_poses(
        track.time_s[use], track.position_m[use], track.quaternion[use], own[use], unmodelled=unmodelled,
        gravity_m_s2=track.gravity_m_s2, turning=track.turning,
    )  # fmt: skip


def with_calibrated_covariance(track: Track, die: Die, camera: Camera | None = None, *, every: int = 1) -> Track:
    """The track with covariances as large as the errors of the poses about their flights, autocorrelated errors included, plus
    the covariance of the errors that all poses share, but for those of the calibration. The poses stay as they are; without a
    flight the track is returned unchanged."""
    try:
        found = measure(track, die, camera, every=every)
    except NoFlightError:
        return track
    use = np.flatnonzero(track.tracked)
    covariance = track.covariance.copy()
    covariance[use] = _with_variance(track, use, found.chain.errors.variance) + found.shared_covariance[use]
    return replace(
        track,
        covariance=covariance,
        pixel_covariance=track.covariance if track.pixel_covariance is None else track.pixel_covariance,
    )


def _with_variance(track: Track, use: NDArray[np.int64], variance: Array) -> Array:
    """Covariances (n, 6, 6) of poses whose whitened errors have these variances (6,)."""
    root = np.linalg.inv(weighted_poses(track, use, UNMODELLED_SHARE).whitener)
    return np.asarray((root * variance) @ np.swapaxes(root, 1, 2))


def _independent(track: Track, throw: Throw, chain: FlightChain, shared_covariance: Array) -> Track:
    """The track with the long-run variance of the errors, and with the covariance that all frames of a flight share multiplied by
    the number of its frames. The table determines the shared errors of a die that it supports."""
    use = np.flatnonzero(track.tracked)
    spacing_s = float(np.median(np.diff(track.time_s[use])))
    flight = throw.flights_at(track.time_s[use])
    is_flight = np.array([one.covariance is not None for one in throw.flights])
    count = np.where(is_flight, np.bincount(flight, minlength=len(is_flight)), 0)[flight]
    if track.pixel_covariance is not None:
        # A frame of a supported die enters no mean: its covariance stays as stated, or as corrected by the table.
        use, count = use[count > 0], count[count > 0]
    covariance = track.covariance.copy()
    long_run = _with_variance(track, use, chain.errors.long_run_variance(spacing_s))
    covariance[use] = long_run + count[:, None, None] * shared_covariance[use]
    return replace(track, covariance=covariance, pixel_covariance=None)


def _shared_covariance(track: Track, bias_jacobian: Array, left: Array, use: NDArray[np.int64], flying: int) -> Array:
    """(track rows, 6, 6) covariance of the pose errors that all frames share, of the rows in use, the first `flying` of them in
    flight; other rows take that of the nearest.

    For poses on edges it follows from their bias Jacobian (track rows, 6, m) and the standard deviations `left` (rows in use, m)
    of its errors, both empty without a camera; for poses on marks it is the track's own."""
    covariance = np.zeros((len(track), 6, 6))
    jacobian = bias_jacobian[use]
    covariance[use] = (jacobian * left[:, None] ** 2) @ np.swapaxes(jacobian, 1, 2)
    if track.shared_covariance is not None and np.isfinite(track.shared_covariance[use]).any():
        # Poses on marks share the errors of the marks' places instead of those of edges. Poses of a supported die rest on edges.
        by_edges = np.isnan(track.shared_covariance[use]).any((1, 2)) & (np.arange(len(use)) >= flying)
        covariance[use[~by_edges]] = track.shared_covariance[use[~by_edges]]
    return _filled(covariance, use)


def _filled(covariance: Array, use: NDArray[np.int64]) -> Array:
    """Covariances (n, 6, 6) of all rows of a track, given those of the rows in use, some NaN: the others take the nearest. A
    frame that could not be refined on marks has none, and lost frames may yet be supplied by their flight."""
    known = use[np.isfinite(covariance[use]).all((1, 2))]
    return np.asarray(covariance[known[_nearest_of(known, len(covariance))]])


def _nearest_of(known: Rows, count: int) -> Rows:
    """For each of so many rows the index of the nearest among some (m,), in ascending order."""
    rows = np.arange(count)
    right = np.minimum(np.searchsorted(known, rows), len(known) - 1)
    left = np.maximum(right - 1, 0)
    return np.where(rows - known[left] < known[right] - rows, left, right)


def _with_shared_covariance(throw: Throw, time_s: Array, shared_covariance: Array) -> Throw:
    """The throw with the shared covariances (n, 6, 6) of its frames at some instants (n,) added: to each flight the median one of
    its frames."""
    flight_of = throw.flights_at(time_s)
    flights = []
    for k, flight in enumerate(throw.flights):
        inside = flight_of == k
        own = shared_covariance[inside] if inside.any() else shared_covariance
        flights.append(_plus_constant_error(flight, _median_covariance(own)))
    return replace(throw, flights=tuple(flights))


def _median_covariance(covariances: Array) -> Array:
    """The covariance (6, 6) of median size among several (n, 6, 6). The element-wise median may have negative eigenvalues."""
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    size = (variances / np.maximum(np.median(variances, axis=0), 1e-300)).sum(1)
    return np.asarray(covariances[np.argsort(size)[len(covariances) // 2]])


def _plus_constant_error(flight: Flight, covariance: Array) -> Flight:
    """The flight with a constant pose error of this covariance (6, 6) added: rotated poses rotate the spin as well. Supported
    motion has no covariance, and is returned unchanged."""
    if flight.covariance is None:
        return flight
    by_error = np.zeros((12, 6))
    by_error[:6] = np.eye(6)
    by_error[9:, 3:] = -cross_matrix(flight.start.omega_rad_s)
    return replace(flight, covariance=flight.covariance + by_error @ covariance @ by_error.T)


# --- impacts -----------------------------------------------------------------------------------------------------------


def _with_supported_motion(
    flights: tuple[Flight, ...], impacts: tuple[Impact, ...], observations: WeightedPoses, last_s: float, die: Die
) -> tuple[tuple[Flight, ...], tuple[Impact, ...]]:
    """Flights and impacts with the end during which the table supports the die, from midway between the last frame in flight and
    the next."""
    begin, end = 0.5 * (last_s + float(observations.time_s[0])), float(observations.time_s[-1])
    gravity_m_s2 = observations.gravity_m_s2
    supported = SupportedMotion(
        start=State(begin, observations.position_m[0], observations.quaternion[0], np.zeros(3), np.zeros(3)),
        end_s=end,
        times_s=observations.time_s,
        positions_m=observations.position_m,
        quaternions=observations.quaternion,
        gravity_m_s2=gravity_m_s2,
    )
    count = sum(impact.time_s < begin for impact in impacts)
    flights, impacts = flights[: count + 1], impacts[:count]
    before, after = flights[-1].at(begin), supported.at(begin)
    held = Impact(
        begin, "held", resting_vertices(die, supported.at(end).rotation), before.position_m[:2], np.full(3, np.nan),
        np.nan, np.nan, energy_J(die, before, gravity_m_s2), energy_J(die, after, gravity_m_s2),
        lowest_face(die.solid, before.rotation), lowest_face(die.solid, supported.at(end).rotation),
    )  # fmt: skip
    return (*flights[:-1], replace(flights[-1], end_s=begin), supported), (*impacts, held)


def _believed(time_s: Array, quaternion: Array, chain: FlightChain) -> NDArray[np.bool_]:
    """(flights,) whether more than BELIEVED_SHARE of a flight's frames, at instants (n,) with orientations (n, 4), lie on it.
    Otherwise the frames may show another contact or a rolling die, and the flight is where the fit had to put it.

    Frames of another flight, or of another labelling, make the errors of all frames seem large; all may then lie within these
    errors, though their orientation is not that of the flight."""
    believed = np.ones(len(chain.flights), bool)
    for k, part in enumerate(chain.parts(time_s)):
        if len(time_s[part]):
            off_rad = angle_between(quaternion[part], chain.flights[k].poses(time_s[part])[1])
            believed[k] = ((chain.weights[part] > 0.0) & (off_rad < OFF_FLIGHT_RAD)).mean() > BELIEVED_SHARE
    return believed


def _impacts(chain: FlightChain, believed: NDArray[np.bool_], die: Die, limit_s: float) -> tuple[Impact, ...]:
    """The impact at each link; unresolved if a flight beside it is not believed, or its instant less certain than `limit_s`."""
    return tuple(
        _impact(chain, die, k, limit_s, believed=bool(believed[k] and believed[k + 1])) for k in range(len(chain.links))
    )


def _impact(chain: FlightChain, die: Die, k: int, limit_s: float, *, believed: bool) -> Impact:
    """One impact: contact, velocities of the contact point on both sides, apparent restitution with its interval."""
    link, before, after = chain.links[k], chain.flights[k], chain.flights[k + 1]
    t = link.time_s
    a, b = before.at(t), after.at(t)
    touching, arm = _contact(link, die, a)
    v_before, v_after = normal_velocity(a, arm), normal_velocity(b, arm)
    is_known = chain.sigma_time_s[k] < limit_s
    is_resolved = believed and not link.is_open and is_known and v_before < 0.0 < v_after
    contact = {1: "vertex", 2: "edge"}.get(len(touching), "face") if is_resolved else "unresolved"
    chi, low, high = np.nan, np.nan, np.nan
    if is_resolved:
        chi = -v_after / v_before
        rows = normal_velocity_jacobian(a, b, arm, before.gravity_m_s2)
        low, high = _restitution_interval(rows @ chain.joint_covariance[k] @ rows.T, v_before, v_after)
    middle_before = before.at(0.5 * (before.start.time_s + before.end_s))
    middle_after = after.at(0.5 * (after.start.time_s + after.end_s))
    return Impact(
        t,
        contact,
        touching if is_resolved else (),
        (a.position_m + arm)[:2],
        die.mass_kg * (b.velocity_m_s - a.velocity_m_s),
        v_before,
        v_after,
        energy_J(die, a, before.gravity_m_s2),
        energy_J(die, b, after.gravity_m_s2),
        lowest_face(die.solid, middle_before.rotation),
        lowest_face(die.solid, middle_after.rotation),
        sigma_time_s=float(chain.sigma_time_s[k]),
        chi=chi,
        chi_low=low,
        chi_high=high,
    )


def _contact(link: Link, die: Die, state: State) -> tuple[tuple[int, ...], Array]:
    """The vertices that touch, and the contact point (3,) [m] from the centre."""
    inner = inner_vertices(die.solid, die.corner_radius_m)
    if link.impact is not None:
        vertex = int(np.argmin(np.linalg.norm(inner - link.impact.point_m, axis=1)))
        return (vertex,), link.impact.arm(state.rotation)
    touching = resting_vertices(die, state.rotation)
    arms = inner[list(touching)] @ state.rotation.T
    return touching, np.asarray(arms.mean(0) - np.array([0.0, 0.0, die.corner_radius_m]))


def _restitution_interval(covariance: Array, v_before: float, v_after: float) -> tuple[float, float]:
    """95 % interval of the apparent restitution, by drawing both normal velocities from their covariance (2, 2)."""
    draws = np.random.default_rng(SEED).standard_normal((DRAWS, 2)) @ covariance_root(covariance).T
    before, after = (np.array([v_before, v_after]) + draws).T
    low, high = np.percentile(-after / before, INTERVAL_PERCENT)
    return float(low), float(high)
