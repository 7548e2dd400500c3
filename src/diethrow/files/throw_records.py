"""The tables of a throw: body frame, poses and bounces. This module reads and writes them, and computes nothing.

| file | holds |
| --- | --- |
| `vertices.csv` | the body frame: one corner of the sharp polyhedron a row |
| `faces.csv` | one face a row: its index, the number printed on it (empty where it was not read), its corners |
| `track.csv`, `track_covariance.npy` | the poses, smoothed within each flight |
| `track_frames.csv`, `track_frames_covariance.npy` | the poses of each frame alone, without the errors common to all: for a fit |
| `bounces.csv` | one impact a row |
| `simulated.csv` | the model's poses, columns as `track.csv` without `status` |

`fit_records` has the fit, `csv_and_json` how numbers are written.
"""

from __future__ import annotations

import math
import tokenize
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.die import Solid
from ..model.errors import InputError
from ..model.rotations import continuous_sign
from ..model.throw import EVEN, Impact, Throw, Turning
from ..model.world import GRAVITY_M_S2
from ..tracking.track import ABSENT, LOST, TRACKED, Track
from .csv_and_json import Table, read_table, write_table

Array = NDArray[np.float64]

FACE_COLUMNS = ("face", "number", "vertices")
POSITION_COLUMNS = ("x_m", "y_m", "z_m")
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
POSE_COLUMNS = ("frame", "t_s", *POSITION_COLUMNS, *QUATERNION_COLUMNS)
SIGMA_COLUMNS = ("sigma_x_m", "sigma_y_m", "sigma_z_m", "sigma_rx_rad", "sigma_ry_rad", "sigma_rz_rad")
SIMULATED_COLUMNS = (*POSE_COLUMNS, *SIGMA_COLUMNS)
TRACK_COLUMNS = (*SIMULATED_COLUMNS, "status")
VERTEX_COLUMNS = ("vertex", *POSITION_COLUMNS)
BOUNCE_COLUMNS = (
    "bounce",
    "t_s",
    "sigma_t_s",
    "contact",
    "vertices",
    "x_m",
    "y_m",
    "normal_velocity_before_m_s",
    "normal_velocity_after_m_s",
    "chi",
    "chi_low",
    "chi_high",
    "energy_before_J",
    "energy_after_J",
    "lowest_face_before",
    "lowest_face_after",
)
CONTACTS = ("vertex", "edge", "face", "unresolved")
STATUSES = (TRACKED, LOST, ABSENT)
MAX_LENGTH_ERROR = 1e-3
"""Of a quaternion's length: rounding to four digits is admitted, another unit or order of columns is not."""
ROUNDING_S = 1e-9
"""Times closer than this to the ends of a simulated throw belong to it."""
NPY_ERRORS = (ValueError, KeyError, TypeError, EOFError, OSError, SyntaxError, RecursionError, tokenize.TokenError)
"""What numpy raises for a damaged header, depending on the damage."""
MAX_REASON_CHARACTERS = 200
"""Of numpy's reason, in an error: it may quote the damage at length."""


# --- the body frame ---


def write_vertices(path: Path, solid: Solid) -> None:
    """The corners of the sharp polyhedron, body frame [m]."""
    write_table(path, VERTEX_COLUMNS, ((k, *row) for k, row in enumerate(solid.vertices.tolist())))


def read_vertices(path: Path) -> Array:
    """Corners (n, 3) [m]. Raises ValueError for a table without them."""
    return read_table(path, VERTEX_COLUMNS).numbers(POSITION_COLUMNS)


def write_faces(path: Path, solid: Solid, numbers: Sequence[int | None]) -> None:
    """The faces, by the indices that the other tables use: the number that each carries, and its corners."""
    faces = enumerate(zip(numbers, solid.faces, strict=True))
    write_table(path, FACE_COLUMNS, ((k, number, " ".join(map(str, face))) for k, (number, face) in faces))


# --- tracks ---


def write_track(path: Path, track: Track) -> None:
    """`track.csv` at `path`, and the covariances next to it as `track_covariance.npy`."""
    columns = zip(_poses(track), _sigmas(track), track.status, strict=True)
    write_table(path, TRACK_COLUMNS, ((*pose, *sigmas, str(status)) for pose, sigmas, status in columns))
    write_covariances(covariance_path(path), track)


def write_covariances(path: Path, track: Track) -> None:
    """The covariances of all poses: float64 (rows, 6, 6), NaN where there is none."""
    with path.open("wb") as file:
        np.save(file, np.ascontiguousarray(track.covariance, np.float64), allow_pickle=False)


def read_track(path: Path, gravity_m_s2: float = GRAVITY_M_S2, turning: Turning = EVEN) -> Track:
    """The track at `path`, with the covariances in the file next to it, of a die that falls with `gravity_m_s2`, and turns as a
    spherical top or as `turning_of` the die says.

    Without `…_covariance.npy` the sigma columns make diagonal covariances; without those too, they are NaN. Raises
    FileNotFoundError, and ValueError with file, row, column and value for what is not a track.
    """
    table = read_table(path, (*POSE_COLUMNS, "status"), allowed=TRACK_COLUMNS)
    if not len(table):
        raise InputError(f"{path}: the table has no rows; wanted one row a frame")
    status = np.array([table.text(k, "status", STATUSES) for k in range(len(table))])
    known = status == TRACKED
    frame, time_s = _frames_and_times(table)
    if (np.diff(time_s) <= 0).any():
        k = int(np.argmax(np.diff(time_s) <= 0)) + 1
        raise InputError(f"{path}: t_s = {time_s[k]} in row {k + 1} does not rise; wanted times in order")
    if (np.diff(frame) <= 0).any():
        k = int(np.argmax(np.diff(frame) <= 0)) + 1
        raise InputError(
            f"{path}: frame = {frame[k]} in row {k + 1}, after {frame[k - 1]}; wanted frame numbers in order, each of them once"
        )
    position, quaternion = table.numbers(POSITION_COLUMNS, known), table.numbers(QUATERNION_COLUMNS, known)
    lengths = np.linalg.norm(quaternion[known], axis=1)
    if (abs(lengths - 1.0) > MAX_LENGTH_ERROR).any():
        k = int(np.flatnonzero(known)[np.argmax(abs(lengths - 1.0))])
        raise InputError(f"{path}: qw to qz in row {k + 1} have length {np.linalg.norm(quaternion[k]):.6g}; wanted 1")
    covariance = _covariance(table, known)
    return Track(
        frame, time_s, position, quaternion, covariance, status, gravity_m_s2=gravity_m_s2, turning=turning
    )  # fmt: skip


def covariance_path(track_path: Path) -> Path:
    """The file of a track's covariances: `track.csv` has `track_covariance.npy`."""
    return track_path.with_name(f"{track_path.stem}_covariance.npy")


def write_simulated(path: Path, track: Track) -> None:
    """The model's track: columns as `track.csv` without `status`; the sigmas are empty where the model has none."""
    rows = zip(_poses(track), _sigmas(track), strict=True)
    write_table(path, SIMULATED_COLUMNS, ((*pose, *sigmas) for pose, sigmas in rows))


def read_simulated(path: Path) -> Track:
    """The model's track; a row without numbers is ABSENT. Raises as `read_track`."""
    table = read_table(path, POSE_COLUMNS, allowed=SIMULATED_COLUMNS)
    known = np.array([not table.is_empty(k, ("x_m",)) for k in range(len(table))], bool)
    frame, time_s = _frames_and_times(table)
    position, quaternion = table.numbers(POSITION_COLUMNS, known), table.numbers(QUATERNION_COLUMNS, known)
    covariance = np.full((len(table), 6, 6), np.nan)
    return Track(frame, time_s, position, quaternion, covariance, np.where(known, TRACKED, ABSENT))


def simulated_track(throw: Throw, frame: NDArray[np.int64], time_s: Array) -> Track:
    """The poses of a model's throw at times (n,) [s], as a track without covariances.

    Times before the release and after the end of the last flight are ABSENT: the model has no pose for them.
    """
    begins, ends = throw.flights[0].start.time_s, throw.flights[-1].end_s
    covered = (time_s >= begins - ROUNDING_S) & (time_s <= ends + ROUNDING_S)
    position, quaternion = np.full((len(time_s), 3), np.nan), np.full((len(time_s), 4), np.nan)
    position[covered], quaternion[covered] = throw.poses(time_s[covered])
    unknown = np.full((len(time_s), 6, 6), np.nan)
    return Track(frame, time_s, position, continuous_sign(quaternion), unknown, np.where(covered, TRACKED, ABSENT))


def _frames_and_times(table: Table) -> tuple[NDArray[np.int64], Array]:
    frame = np.array([table.whole(k, "frame") for k in range(len(table))], np.int64)
    return frame, table.numbers(("t_s",))[:, 0]


def _poses(track: Track) -> Iterable[tuple[Any, ...]]:
    columns = (track.frame, track.time_s, track.position_m, track.quaternion, track.tracked)
    for frame, time_s, position, quaternion, known in zip(*columns, strict=True):
        numbers = [*position.tolist(), *quaternion.tolist()] if known else [None] * 7
        yield (int(frame), float(time_s), *numbers)


def _sigmas(track: Track) -> list[list[float]]:
    variances = np.einsum("kii->ki", track.covariance)
    with np.errstate(invalid="ignore"):
        sigmas = np.where(variances >= 0, np.sqrt(variances), np.nan)
    sigmas[~track.tracked] = np.nan
    return list(sigmas.tolist())


def _covariance(table: Table, known: NDArray[np.bool_]) -> Array:
    """(n, 6, 6) from the file next to the track, else from its sigmas; NaN where neither is there."""
    path = covariance_path(table.path)
    if path.exists():
        return np.where(known[:, None, None], _covariance_in(path, len(table)), np.nan)
    covariance = np.full((len(table), 6, 6), np.nan)
    for k in np.flatnonzero(known).tolist():
        if not table.is_empty(k, SIGMA_COLUMNS):
            covariance[k] = np.diag([table.number(k, name) ** 2 for name in SIGMA_COLUMNS])
    return covariance


def _covariance_in(path: Path, count: int) -> Array:
    """(count, 6, 6) of a .npy file; its header is checked before memory is taken for what it declares."""
    wanted = f"wanted float64 ({count}, 6, 6)"
    try:
        with path.open("rb") as file:
            version = np.lib.format.read_magic(file)
            read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
            shape, _, dtype = read_header[version](file)
        if dtype.kind != "f":
            raise InputError(f"{path}: not an array of numbers ({dtype}); {wanted}")
        if shape != (count, 6, 6):
            raise InputError(f"{path}: {dtype} of shape {shape}; {wanted}")
        covariance = np.load(path, allow_pickle=False)
    except NPY_ERRORS as error:
        reason = str(error)[:MAX_REASON_CHARACTERS]
        own = reason.startswith(str(path))
        raise InputError(reason if own else f"{path}: not an array of numbers ({reason}); {wanted}") from error
    return np.asarray(covariance, np.float64)


# --- bounces ---


def write_bounces(path: Path, impacts: Sequence[Impact]) -> None:
    """`bounces.csv`: one impact a row, numbered from 1."""
    write_table(path, BOUNCE_COLUMNS, bounce_rows(impacts))


def bounce_rows(impacts: Sequence[Impact]) -> list[tuple[Any, ...]]:
    """The rows of `bounces.csv`."""
    return [_bounce_row(k + 1, impact) for k, impact in enumerate(impacts)]


def read_bounces(path: Path) -> tuple[Impact, ...]:
    """The impacts of `bounces.csv`; the impulse is not in the file and comes back as NaN. Raises as `read_track`."""
    table = read_table(path, BOUNCE_COLUMNS)
    return tuple(_impact(table, k) for k in range(len(table)))


def _bounce_row(number: int, impact: Impact) -> tuple[Any, ...]:
    return (
        number,
        impact.time_s,
        impact.sigma_time_s,
        impact.contact,
        " ".join(str(vertex) for vertex in impact.vertices),
        *np.asarray(impact.point_m, float).tolist(),
        impact.normal_velocity_before_m_s,
        impact.normal_velocity_after_m_s,
        impact.chi,
        impact.chi_low,
        impact.chi_high,
        impact.energy_before_J,
        impact.energy_after_J,
        impact.lowest_face_before,
        impact.lowest_face_after,
    )


def _impact(table: Table, k: int) -> Impact:
    def number(column: str) -> float:
        return table.number(k, column, empty=math.nan)

    return Impact(
        contact=table.text(k, "contact", CONTACTS),
        time_s=table.number(k, "t_s"),
        vertices=_vertices(table, k),
        point_m=np.array([number("x_m"), number("y_m")]),
        impulse_N_s=np.full(3, np.nan),
        normal_velocity_before_m_s=number("normal_velocity_before_m_s"),
        normal_velocity_after_m_s=number("normal_velocity_after_m_s"),
        energy_before_J=number("energy_before_J"),
        energy_after_J=number("energy_after_J"),
        lowest_face_before=table.whole(k, "lowest_face_before"),
        lowest_face_after=table.whole(k, "lowest_face_after"),
        sigma_time_s=number("sigma_t_s"),
        chi=number("chi"),
        chi_low=number("chi_low"),
        chi_high=number("chi_high"),
    )


def _vertices(table: Table, k: int) -> tuple[int, ...]:
    parts = table.rows[k]["vertices"].split()
    if not all(part.isdecimal() for part in parts):
        raise table.error(k, "vertices", "indices separated by spaces")
    return tuple(int(part) for part in parts)
