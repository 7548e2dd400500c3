"""What tracking knows of a throw beside the poses of its frames, in one file, so that a fit of them gives what `analyze` gives.

`track_frames.csv` has `track_frames_throw.npz` next to it, with arrays of numpy:

| array | what |
| --- | --- |
| `format` | version of this file: 2 |
| `frame` (n,) | frame numbers, those of the table |
| `unexplained` (n,) | whether no flight explains a frame: no model is fitted to it |
| `flight_state` (f, 14) | beginning of each flight: t [s], position [m], quaternion wxyz, velocity [m/s], spin [rad/s] |
| `flight_end_s` (f,) | its end |
| `flight_covariance` (f, 12, 12) | of position, rotation vector, velocity and spin, world axes |
| `impact_numbers` (f - 1, 16) | IMPACT_COLUMNS of each impact |
| `impact_contact`, `impact_vertices` (f - 1,) | words, and indices of `vertices.csv`, space separated |
| `gravity_m_s2`, `corner_radius_m` | with which the die was tracked |
| `face_numbers` (faces,) | the number of each face; 0 where it is not known |
| `shared_jacobian` (n, 6, m), `shared_subtracted` (m,), `shared_sources` (m,) | `SharedErrors`; m is 0 where all is exact |
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..model.die import Die
from ..model.errors import InputError
from ..model.throw import Flight, Impact, Throw, turning_of
from ..tracking.clip_parameters import CornerRounding
from ..tracking.flights import packed, unpacked
from ..tracking.surface_marks import FaceNumbers, with_numbers
from ..tracking.track import CALIBRATION, CLOCK, DIE, SharedErrors, Track

Array = NDArray[np.float64]

FORMAT = 2
"""Version of the file."""
IMPACT_COLUMNS = (
    *("time_s", "sigma_time_s", "x_m", "y_m", "impulse_x_N_s", "impulse_y_N_s", "impulse_z_N_s"),
    *("normal_velocity_before_m_s", "normal_velocity_after_m_s", "energy_before_J", "energy_after_J"),
    *("lowest_face_before", "lowest_face_after", "chi", "chi_low", "chi_high"),
)
"""Numbers of an impact; NaN where unknown."""


@dataclass(frozen=True, eq=False)
class TrackedThrow:
    """The frames of a track that a model is fitted to, and what tracking knows beside them."""

    frames: Track
    """Single frames, with the errors that they share."""
    throw: Throw
    """The flights that they show, with covariances, and the impacts between them."""
    die: Die
    """With the radius of its corners and the numbers of its faces as found."""
    face_numbers: tuple[int | None, ...]
    """The number on each face; None where it is not known."""


def throw_path(track_path: Path) -> Path:
    """The file beside a track: `track_frames.csv` has `track_frames_throw.npz`."""
    return track_path.with_name(f"{track_path.stem}_throw.npz")


def write_measured_throw(track_path: Path, tracked: TrackedThrow) -> None:
    """The file beside the track at `track_path`, of a throw in flight to its end."""
    flights, impacts = tracked.throw.flights, tracked.throw.impacts
    shared = tracked.frames.shared_errors
    if shared is None:
        shared = SharedErrors(np.zeros((len(tracked.frames), 6, 0)), (), np.zeros(0))
    unknown = np.full((12, 12), np.nan)
    np.savez(
        throw_path(track_path),
        format=np.array(FORMAT),
        frame=tracked.frames.frame,
        unexplained=np.zeros(len(tracked.frames), bool)
        if tracked.frames.unexplained is None
        else tracked.frames.unexplained,
        flight_state=np.array([packed(flight.start) for flight in flights]),
        flight_end_s=np.array([flight.end_s for flight in flights]),
        flight_covariance=np.array([unknown if one.covariance is None else one.covariance for one in flights]),
        impact_numbers=np.array([_numbers(impact) for impact in impacts]).reshape(-1, len(IMPACT_COLUMNS)),
        impact_contact=np.array([impact.contact for impact in impacts], str),
        impact_vertices=np.array([" ".join(map(str, impact.vertices)) for impact in impacts], str),
        gravity_m_s2=np.array(tracked.frames.gravity_m_s2),
        corner_radius_m=np.array(tracked.die.corner_radius_m),
        face_numbers=np.array([number or 0 for number in tracked.face_numbers]),
        shared_jacobian=shared.jacobian,
        shared_subtracted=shared.subtracted,
        shared_sources=np.array(shared.sources, str),
    )


def read_measured_throw(track_path: Path, frames: Track, die: Die, rounding: CornerRounding) -> TrackedThrow | None:
    """What lies beside a track, whose table is read already; None if nothing does. `die` is that of the scene, and its radius
    counts if it is given. Raises ValueError for a file that is damaged or of another track."""
    path = throw_path(track_path)
    if not path.exists():
        return None
    advice = f"remove {path.name} to fit the table alone"
    try:
        # Opened here: a damaged archive would be left open.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            arrays = {name: data[name] for name in data.files}
        if int(arrays["format"]) != FORMAT:
            raise InputError(f"format {int(arrays['format'])}, wanted {FORMAT}")
        if rounding is not CornerRounding.GIVEN and float(arrays["corner_radius_m"]) != die.corner_radius_m:
            die = die.with_corner_radius(float(arrays["corner_radius_m"]))
        found = _tracked_throw(arrays, frames, die)
    except (OSError, ValueError, KeyError, IndexError, TypeError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not what belongs to {track_path.name} ({error}); {advice}") from error
    return found


def _tracked_throw(arrays: dict[str, NDArray], frames: Track, die: Die) -> TrackedThrow:
    """What the arrays of a file hold. Raises ValueError where they do not fit each other or the frames."""
    n, count = len(frames), len(arrays["flight_end_s"])
    if not np.array_equal(arrays["frame"], frames.frame):
        raise InputError(f"frames of its own: {len(arrays['frame'])}, and {n} in the table")
    if float(arrays["gravity_m_s2"]) != frames.gravity_m_s2:
        raise InputError(
            f"tracked with gravity_m_s2 = {float(arrays['gravity_m_s2']):g}, the scene has {frames.gravity_m_s2:g}"
        )
    m = len(arrays["shared_subtracted"])
    wanted = {
        "unexplained": (n,),
        "flight_state": (count, 14),
        "flight_covariance": (count, 12, 12),
        "impact_numbers": (count - 1, len(IMPACT_COLUMNS)),
        "impact_contact": (count - 1,),
        "impact_vertices": (count - 1,),
        "face_numbers": (len(die.solid.faces),),
        "shared_jacobian": (n, 6, m),
        "shared_sources": (m,),
    }
    for name, shape in wanted.items():
        if arrays[name].shape != shape:
            raise InputError(f"{name} of shape {arrays[name].shape}, wanted {shape}")
    sources = tuple(str(source) for source in arrays["shared_sources"])
    if not set(sources) <= {CALIBRATION, DIE, CLOCK}:
        raise InputError(f"shared_sources {sources}, wanted {CALIBRATION}, {DIE} or {CLOCK}")
    flights, turning = [], turning_of(die)
    for state, end_s, covariance in zip(
        arrays["flight_state"], arrays["flight_end_s"], arrays["flight_covariance"], strict=True
    ):
        known = covariance if np.isfinite(covariance).all() else None
        flights.append(Flight(unpacked(state), float(end_s), known, frames.gravity_m_s2, turning))
    words = zip(arrays["impact_contact"], arrays["impact_vertices"], strict=True)
    impacts = [
        _impact(numbers, str(contact), str(vertices))
        for numbers, (contact, vertices) in zip(arrays["impact_numbers"], words, strict=True)
    ]
    shared = SharedErrors(arrays["shared_jacobian"], sources, arrays["shared_subtracted"]) if m else None
    numbers = tuple(int(number) or None for number in arrays["face_numbers"])
    return TrackedThrow(
        replace(frames, shared_errors=shared, unexplained=arrays["unexplained"].astype(bool), turning=turning),
        Throw(tuple(flights), tuple(impacts)),
        with_numbers(die, FaceNumbers(numbers, 1.0, "")),
        numbers,
    )


def _numbers(impact: Impact) -> list[float]:
    return [
        impact.time_s, impact.sigma_time_s, *impact.point_m.tolist(), *impact.impulse_N_s.tolist(),
        impact.normal_velocity_before_m_s, impact.normal_velocity_after_m_s, impact.energy_before_J, impact.energy_after_J,
        impact.lowest_face_before, impact.lowest_face_after, impact.chi, impact.chi_low, impact.chi_high,
    ]  # fmt: skip


def _impact(numbers: Array, contact: str, vertices: str) -> Impact:
    named = dict(zip(IMPACT_COLUMNS, numbers.tolist(), strict=True))
    return Impact(
        named["time_s"],
        contact,
        tuple(int(vertex) for vertex in vertices.split()),
        numbers[2:4],
        numbers[4:7],
        named["normal_velocity_before_m_s"],
        named["normal_velocity_after_m_s"],
        named["energy_before_J"],
        named["energy_after_J"],
        int(named["lowest_face_before"]),
        int(named["lowest_face_after"]),
        sigma_time_s=named["sigma_time_s"],
        chi=named["chi"],
        chi_low=named["chi_low"],
        chi_high=named["chi_high"],
    )
