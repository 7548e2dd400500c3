"""The files of a result: read and written, nothing computed.

Numbers are written with all their digits, so that what is read back is what was written, bit by bit. What is not known
is an empty cell in a table, `null` in JSON and NaN in an array.

| file | holds |
| --- | --- |
| `vertices.csv` | the body frame: one corner of the sharp polyhedron a row |
| `faces.csv` | one face a row: its index, the number printed on it (empty where not read), its corners |
| `track.csv`, `track_covariance.npy` | the poses, smoothed within each flight |
| `track_frames.csv`, `track_frames_covariance.npy` | the poses of each frame alone, less what all err alike: for a fit |
| `bounces.csv` | one impact a row |
| `fit.json` | parameters, initial conditions, effects, messages |
| `simulated.csv` | the model's poses, columns as `track.csv` without `status` |
"""

from __future__ import annotations

import csv
import json
import math
import tokenize
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..fitting.results import Effect, Fit, Parameter
from ..model.die import Solid
from ..model.laws import CoulombImpact, FrictionBySpeed, Restitution, RestitutionBySpeed, SmoothImpact
from ..model.rotations import continuous_sign, euler_from_quat, matrix_from_quat
from ..model.throw import Impact, State, Throw
from ..tracking.track import ABSENT, LOST, TRACKED, Track

Array = NDArray[np.float64]

FACE_COLUMNS = ("face", "number", "vertices")
POSE_COLUMNS = ("frame", "t_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
SIGMA_COLUMNS = ("sigma_x_m", "sigma_y_m", "sigma_z_m", "sigma_rx_rad", "sigma_ry_rad", "sigma_rz_rad")
SIMULATED_COLUMNS = (*POSE_COLUMNS, *SIGMA_COLUMNS)
TRACK_COLUMNS = (*SIMULATED_COLUMNS, "status")
VERTEX_COLUMNS = ("vertex", "x_m", "y_m", "z_m")
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
LARGEST_FILE_BYTES = 2**27
"""A table of a track of 300 000 frames; what is larger would fill memory before it is refused."""
LARGEST_NUMBER = 1e100
"""In SI units; its square is still a number."""
LARGEST_FRAME = 2**53
"""Frame numbers are whole numbers that a double holds."""
NPY_DAMAGE = (ValueError, KeyError, TypeError, EOFError, OSError, SyntaxError, RecursionError, tokenize.TokenError)
"""What numpy raises on a damaged header, depending on where the damage is."""
LONGEST_CELL = 1000
"""Characters of one cell; no number needs more, and a file that is no table is refused before it fills memory."""


# --- the body frame ---


def write_vertices(path: Path, solid: Solid) -> None:
    """The corners of the sharp polyhedron, body frame [m]."""
    _write_table(path, VERTEX_COLUMNS, ((k, *row) for k, row in enumerate(solid.vertices.tolist())))


def write_faces(path: Path, solid: Solid, numbers: Sequence[int | None]) -> None:
    """The faces, by the indices that the other tables use: what number each carries, and its corners."""
    rows = (
        (k, number, " ".join(map(str, face))) for k, (number, face) in enumerate(zip(numbers, solid.faces, strict=True))
    )
    _write_table(path, FACE_COLUMNS, rows)


def read_vertices(path: Path) -> Array:
    """Corners (n, 3) [m]. Raises ValueError for a table that is not one of corners."""
    rows = _read_table(path, VERTEX_COLUMNS)
    return np.array([[_number(path, k, row, name) for name in VERTEX_COLUMNS[1:]] for k, row in enumerate(rows)], float)


# --- tracks ---


def write_track(path: Path, track: Track) -> None:
    """`track.csv` at `path`, and the covariances beside it as `track_covariance.npy`."""
    rows = (
        (*pose, *sigmas, str(status))
        for pose, sigmas, status in zip(_poses(track), _sigmas(track), track.status, strict=True)
    )
    _write_table(path, TRACK_COLUMNS, rows)
    np.save(covariance_path(path), np.ascontiguousarray(track.covariance, np.float64), allow_pickle=False)


def read_track(path: Path) -> Track:
    """The track at `path`, with the covariances that lie beside it.

    Without `…_covariance.npy` the sigma columns make diagonal covariances; without those too, they are NaN. Raises
    FileNotFoundError, and ValueError with file, row, column and value for what is not a track.
    """
    required = (*POSE_COLUMNS, "status")
    rows = _read_table(path, required, allowed=TRACK_COLUMNS)
    if not rows:
        raise ValueError(f"{path}: the table has no rows; wanted one row a frame")
    status = np.array([_status(path, k, row) for k, row in enumerate(rows)])
    known = status == TRACKED
    frame = np.array([_whole(path, k, row, "frame") for k, row in enumerate(rows)], np.int64)
    time_s = np.array([_number(path, k, row, "t_s") for k, row in enumerate(rows)])
    if (np.diff(time_s) <= 0).any():
        k = int(np.argmax(np.diff(time_s) <= 0)) + 1
        raise ValueError(f"{path}: t_s = {time_s[k]} in row {k + 1} does not rise; wanted times in order")
    position = _columns(path, rows, ("x_m", "y_m", "z_m"), known)
    quaternion = _columns(path, rows, ("qw", "qx", "qy", "qz"), known)
    lengths = np.linalg.norm(quaternion[known], axis=1)
    if (abs(lengths - 1.0) > 1e-3).any():
        k = int(np.flatnonzero(known)[np.argmax(abs(lengths - 1.0))])
        raise ValueError(f"{path}: qw to qz in row {k + 1} have length {np.linalg.norm(quaternion[k]):.6g}; wanted 1")
    return Track(frame, time_s, position, quaternion, _covariance(path, rows, known), status)


def covariance_path(track_path: Path) -> Path:
    """Where the covariances of a track lie: `track.csv` has `track_covariance.npy`."""
    return track_path.with_name(f"{track_path.stem}_covariance.npy")


def write_simulated(path: Path, track: Track) -> None:
    """The model's track: columns as `track.csv` without `status`; the sigmas are empty where the model has none."""
    _write_table(
        path, SIMULATED_COLUMNS, ((*pose, *sigmas) for pose, sigmas in zip(_poses(track), _sigmas(track), strict=True))
    )


def read_simulated(path: Path) -> Track:
    """The model's track; a row with empty numbers is ABSENT. Raises as `read_track`."""
    rows = _read_table(path, POSE_COLUMNS, allowed=SIMULATED_COLUMNS)
    known = np.array([row["x_m"] != "" for row in rows], bool)
    frame = np.array([_whole(path, k, row, "frame") for k, row in enumerate(rows)], np.int64)
    time_s = np.array([_number(path, k, row, "t_s") for k, row in enumerate(rows)], float)
    position = _columns(path, rows, ("x_m", "y_m", "z_m"), known)
    quaternion = _columns(path, rows, ("qw", "qx", "qy", "qz"), known)
    status = np.where(known, TRACKED, ABSENT)
    return Track(frame, time_s, position, quaternion, np.full((len(rows), 6, 6), np.nan), status)


def simulated_track(throw: Throw, frame: NDArray[np.int64], time_s: Array) -> Track:
    """The poses of a model's throw at times (n,) [s], as a track without covariances.

    Times before the release and after the end of the last flight are ABSENT: the model says nothing of them.
    """
    rounding_s = 1e-9
    begins, ends = throw.flights[0].start.time_s, throw.flights[-1].end_s
    covered = (time_s >= begins - rounding_s) & (time_s <= ends + rounding_s)
    position, quaternion = np.full((len(time_s), 3), np.nan), np.full((len(time_s), 4), np.nan)
    position[covered], quaternion[covered] = throw.poses(time_s[covered])
    status = np.where(covered, TRACKED, ABSENT)
    unknown = np.full((len(time_s), 6, 6), np.nan)
    return Track(frame, time_s, position, continuous_sign(quaternion), unknown, status)


# --- bounces ---


def write_bounces(path: Path, impacts: Sequence[Impact]) -> None:
    """`bounces.csv`: one impact a row, numbered from 1."""
    _write_table(path, BOUNCE_COLUMNS, (_bounce_row(k + 1, impact) for k, impact in enumerate(impacts)))


def read_bounces(path: Path) -> tuple[Impact, ...]:
    """The impacts of `bounces.csv`; the impulse is not in the file and comes back as NaN. Raises as `read_track`."""
    return tuple(_impact(path, k, row) for k, row in enumerate(_read_table(path, BOUNCE_COLUMNS)))


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


def _impact(path: Path, k: int, row: Mapping[str, str]) -> Impact:
    def number(name: str) -> float:
        return _number(path, k, row, name, empty=math.nan)

    if row["contact"] not in CONTACTS:
        raise _wrong(path, k, "contact", row["contact"], f"one of {', '.join(CONTACTS)}")
    return Impact(
        time_s=_number(path, k, row, "t_s"),
        contact=row["contact"],
        vertices=_vertices(path, k, row),
        point_m=np.array([number("x_m"), number("y_m")]),
        impulse_N_s=np.full(3, np.nan),
        normal_velocity_before_m_s=number("normal_velocity_before_m_s"),
        normal_velocity_after_m_s=number("normal_velocity_after_m_s"),
        energy_before_J=number("energy_before_J"),
        energy_after_J=number("energy_after_J"),
        lowest_face_before=_whole(path, k, row, "lowest_face_before"),
        lowest_face_after=_whole(path, k, row, "lowest_face_after"),
        sigma_time_s=number("sigma_t_s"),
        chi=number("chi"),
        chi_low=number("chi_low"),
        chi_high=number("chi_high"),
    )


def _vertices(path: Path, k: int, row: Mapping[str, str]) -> tuple[int, ...]:
    if not all(part.isdecimal() for part in row["vertices"].split()):
        raise _wrong(path, k, "vertices", row["vertices"], "indices separated by spaces")
    return tuple(int(part) for part in row["vertices"].split())


# --- the fit ---


def write_fit(path: Path, fit: Fit) -> None:
    """`fit.json`: what cannot be had is null, never NaN."""
    write_json(path, fit_tables(fit))


def fit_tables(fit: Fit) -> dict[str, Any]:
    """The fit as JSON has it."""
    return {
        "parameters": parameters_table(fit.parameters),
        "law": law_table(fit.parameters, fit.restitution),
        "initial": None if fit.initial is None else state_table(fit.initial, fit.initial_covariance),
        "effects": {
            "chosen": list(fit.chosen),
            "considered": effects_table(fit.considered),
        },
        "bounces_fitted": fit.bounces_fitted,
        "residual_rms": fit.residual_rms,
        "landed_face": fit.landed_face,
        "face_odds": None if fit.face_odds is None else {str(face): odds for face, odds in fit.face_odds.items()},
        "messages": list(fit.messages),
    }


def parameters_table(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """Parameters as JSON has them, by name."""
    return {name: asdict(parameter) for name, parameter in parameters.items()}


def effects_table(effects: Sequence[Effect]) -> list[dict[str, Any]]:
    """Effects as JSON has them."""
    return [asdict(effect) for effect in effects]


_MEANINGS: dict[Restitution, str] = {
    "stronge": "restitution chi by energy (Stronge)",
    "poisson": "restitution chi by impulse (Poisson)",
    "newton": "restitution chi by normal velocity (Newton)",
}


def law_table(parameters: Mapping[str, Parameter], restitution: Restitution = "stronge") -> dict[str, Any]:
    """The law of impact that parameters of these names belong to: in words, and what no parameter says."""
    rubs = "mu" in parameters
    fading = RestitutionBySpeed(SmoothImpact(1.0), 1.0).exponent if "chi_fade_s_per_m" in parameters else None
    slipping = "mu_fade_s_per_m" in parameters and rubs
    wearing = FrictionBySpeed(CoulombImpact(1.0, 1.0), 1.0).exponent if slipping else None
    words = ["Rigid impact of a corner"]
    if rubs:
        words.append(f"Coulomb friction mu integrated along the normal impulse, {_MEANINGS[restitution]}")
    else:
        words.append("no friction, the normal velocity u goes to -chi u")
    if fading is not None:
        words.append(f"chi falls with the normal speed u as (1 + u chi_fade_s_per_m)^-{fading:g}")
    if wearing is not None:
        words.append(f"mu falls as (1 + u mu_fade_s_per_m)^-{wearing:g}, and is mu where the contact lasts")
    return {
        "words": "; ".join(words) + ".",
        "friction": "coulomb" if rubs else "none",
        "restitution": restitution if rubs else "newton",
        "chi_fade_exponent": fading,
        "mu_fade_exponent": wearing,
    }


def read_parameters(path: Path) -> tuple[dict[str, Parameter], Restitution]:
    """The parameters of a `fit.json`, of one throw or of many, and the kind of restitution, with the law checked that
    they belong to.

    Raises FileNotFoundError, and ValueError with the file and the entry for what is not a fit, for a parameter that was
    not determined, and for a law that is not the one these parameters have here.
    """
    data = read_json(path)
    try:
        parameters = {str(name): Parameter(**values) for name, values in data["parameters"].items()}
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: not a fit ({error!r}); wanted the fit.json that a fit writes") from error
    for name, parameter in parameters.items():
        if not isinstance(parameter.value, (int, float)) or not math.isfinite(parameter.value):
            raise ValueError(f"{path}: parameters.{name}.value = {parameter.value}; wanted a fit that determined it")
    law = data.get("law", law_table(parameters))
    found_kind = law.get("restitution") if isinstance(law, dict) else None
    kind: Restitution = found_kind if "mu" in parameters and found_kind in _MEANINGS else "stronge"
    wanted = law_table(parameters, kind)
    differing = (
        [key for key in wanted if key != "words" and law.get(key) != wanted[key]] if isinstance(law, dict) else ["law"]
    )
    if differing:
        found = law.get(differing[0]) if isinstance(law, dict) else law
        raise ValueError(f"{path}: law.{differing[0]} = {found}; wanted {wanted.get(differing[0], 'a table')}")
    return parameters, kind


def read_fit(path: Path) -> Fit:
    """The fit of `fit.json`, without its throw. Raises FileNotFoundError, and ValueError for what is not a fit."""
    data = read_json(path)
    try:
        initial = data["initial"]
        return Fit(
            parameters={name: Parameter(**values) for name, values in data["parameters"].items()},
            initial=None if initial is None else _state(initial),
            initial_covariance=None if initial is None else _matrix(initial["covariance"]),
            chosen=tuple(data["effects"]["chosen"]),
            considered=tuple(Effect(**values) for values in data["effects"]["considered"]),
            bounces_fitted=data["bounces_fitted"],
            residual_rms=data["residual_rms"],
            landed_face=data["landed_face"],
            face_odds=None if data["face_odds"] is None else {int(f): odds for f, odds in data["face_odds"].items()},
            messages=tuple(data["messages"]),
            throw=None,
            restitution=data["law"]["restitution"] if data["law"]["friction"] != "none" else "stronge",
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"{path}: not a fit ({error!r}); wanted the fit.json that a fit writes") from error


def state_table(state: State, covariance: Array | None = None) -> dict[str, Any]:
    """A state as JSON has it, with the paper's Euler angles and body-frame spin; the covariance is 12 × 12 or null."""
    body = matrix_from_quat(state.quaternion).T @ state.omega_rad_s
    return {
        "t_s": state.time_s,
        "position_m": state.position_m,
        "quaternion_wxyz": state.quaternion,
        "velocity_m_s": state.velocity_m_s,
        "omega_rad_s": state.omega_rad_s,
        "euler_rad": euler_from_quat(state.quaternion),
        "omega_body_rad_s": body,
        "covariance": covariance,
    }


def _state(table: Mapping[str, Any]) -> State:
    return State(
        float(table["t_s"]),
        np.array(table["position_m"], float),
        np.array(table["quaternion_wxyz"], float),
        np.array(table["velocity_m_s"], float),
        np.array(table["omega_rad_s"], float),
    )


def _matrix(rows: Any) -> Array | None:
    return None if rows is None else np.array(rows, float)


# --- JSON and CSV ---


def write_json(path: Path, data: Any) -> None:
    """JSON in UTF-8 with two spaces of indent; arrays become lists, and what is not finite becomes null."""
    text = json.dumps(plain(data), indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """The JSON of a file. Raises FileNotFoundError, and ValueError for what is not JSON."""
    try:
        _demand_small(path)
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: there is no such file; wanted a JSON file") from error
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not valid JSON ({error})") from error


def _demand_small(path: Path) -> None:
    """Raises ValueError for a file that cannot be one of these records."""
    size = path.stat().st_size
    if size > LARGEST_FILE_BYTES:
        raise ValueError(f"{path}: {size} bytes; wanted {LARGEST_FILE_BYTES} at most, is this another kind of file?")


def plain(data: Any) -> Any:
    """`data` in the words of JSON: no arrays, no numpy scalars, no paths, no NaN."""
    if isinstance(data, Mapping):
        return {str(key): plain(value) for key, value in data.items()}
    if isinstance(data, np.ndarray):
        return plain(data.tolist())
    if isinstance(data, (list, tuple)):
        return [plain(value) for value in data]
    if isinstance(data, np.generic):
        return plain(data.item())
    if isinstance(data, float) and not math.isfinite(data):
        return None
    return str(data) if isinstance(data, Path) else data


def _write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: Any) -> str:
    """A number with all its digits; what is not finite is empty."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return repr(float(value)) if isinstance(value, float) else str(value)


def _read_table(path: Path, required: Sequence[str], *, allowed: Sequence[str] | None = None) -> list[dict[str, str]]:
    """Rows of a CSV file with at least the columns `required`, and cells for all of `allowed` (empty if not there)."""
    csv.field_size_limit(LONGEST_CELL)
    try:
        _demand_small(path)
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, restval="")
            names = tuple(reader.fieldnames or ())
            missing = [name for name in required if name not in names]
            if missing:
                raise ValueError(f"{path}: column {missing[0]} is missing; wanted {','.join(required)}")
            empty = dict.fromkeys(allowed or required, "")
            return [{**empty, **{name: (row[name] or "").strip() for name in names}} for row in reader]
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: there is no such file; wanted a CSV table") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path}: not a CSV table in UTF-8 ({error})") from error


def _poses(track: Track) -> Iterable[tuple[Any, ...]]:
    columns = (track.frame, track.time_s, track.position_m, track.quaternion, track.tracked)
    for frame, time_s, position, quaternion, known in zip(*columns, strict=True):
        numbers = [*position.tolist(), *quaternion.tolist()] if known else [None] * 7
        yield (int(frame), float(time_s), *numbers)


def _sigmas(track: Track) -> Iterable[list[float]]:
    variances = np.einsum("kii->ki", track.covariance)
    with np.errstate(invalid="ignore"):
        sigmas = np.where(variances >= 0, np.sqrt(variances), np.nan)
    sigmas[~track.tracked] = np.nan
    return list(sigmas.tolist())


def _covariance(path: Path, rows: Sequence[Mapping[str, str]], known: NDArray[np.bool_]) -> Array:
    """(n, 6, 6) from the file beside the track, else from its sigmas; NaN where neither is there."""
    beside = covariance_path(path)
    if beside.exists():
        return np.where(known[:, None, None], _covariance_beside(beside, len(rows)), np.nan)
    covariance = np.full((len(rows), 6, 6), np.nan)
    for k, row in enumerate(rows):
        if known[k] and all(row[name] != "" for name in SIGMA_COLUMNS):
            covariance[k] = np.diag([_number(path, k, row, name) ** 2 for name in SIGMA_COLUMNS])
    return covariance


def _covariance_beside(path: Path, count: int) -> Array:
    """(count, 6, 6) of a file; its header is asked before memory is taken for what it declares."""
    wanted = f"wanted float64 ({count}, 6, 6)"
    try:
        with path.open("rb") as file:
            version = np.lib.format.read_magic(file)
            read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
            shape, _, dtype = read_header[version](file)
        if dtype.kind != "f":
            raise ValueError(f"{path}: not an array of numbers ({dtype}); {wanted}")
        if shape != (count, 6, 6):
            raise ValueError(f"{path}: {dtype} of shape {shape}; {wanted}")
        covariance = np.load(path, allow_pickle=False)
    except NPY_DAMAGE as error:
        told = str(error)[:200]
        raise ValueError(
            told if told.startswith(str(path)) else f"{path}: not an array of numbers ({told}); {wanted}"
        ) from error
    return np.asarray(covariance, np.float64)


def _columns(path: Path, rows: Sequence[Mapping[str, str]], names: Sequence[str], known: NDArray[np.bool_]) -> Array:
    values = np.full((len(rows), len(names)), np.nan)
    for k in (int(row) for row in np.flatnonzero(known)):
        values[k] = [_number(path, k, rows[k], name) for name in names]
    return values


def _status(path: Path, k: int, row: Mapping[str, str]) -> str:
    if row["status"] not in (TRACKED, LOST, ABSENT):
        raise _wrong(path, k, "status", row["status"], f"one of {TRACKED}, {LOST}, {ABSENT}")
    return row["status"]


def _number(path: Path, k: int, row: Mapping[str, str], name: str, *, empty: float | None = None) -> float:
    if row[name] == "" and empty is not None:
        return empty
    try:
        value = float(row[name])
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST_NUMBER:
        raise _wrong(path, k, name, row[name], "a finite number")
    return value


def _whole(path: Path, k: int, row: Mapping[str, str], name: str) -> int:
    value = _number(path, k, row, name)
    if value != int(value) or abs(value) > LARGEST_FRAME:
        raise _wrong(path, k, name, row[name], "a whole number")
    return int(value)


def _wrong(path: Path, k: int, name: str, value: str, wanted: str) -> ValueError:
    """The error for a cell; rows are counted from 1 below the header."""
    return ValueError(f"{path}: {name} = {value[:60]!r} in row {k + 1}; wanted {wanted}")
