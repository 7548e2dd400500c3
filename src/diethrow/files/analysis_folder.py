"""An analysis in a folder: everything that `diethrow.load` makes the same value from.

Beside the tables of tracking and fitting, `analysis.json` holds the rest:

| entry | what |
| --- | --- |
| `format` | version of the folder: 1 |
| `title`, `fps`, `notices` | of the throw |
| `findings` | checks on the finished throw: name, verdict, measured, advice, values |
| `estimates` | bounce by bounce: bounces, t_s, chi, face_odds |
| `camera` | as the throw shows it: the poses lie on its picture |
| `face_numbers` | read from each face, null where none was |
| `every`, `shrink` | the part of the footage that was used |

The text of the scene is in `provenance.json`. The clip stays where it is; figures made of frames need it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..fitting.predict import Estimate
from ..fitting.results import Fit, Parameter
from ..fitting.throw import throw_of_fit
from ..model.errors import InputError
from ..model.throw import Throw, turning_of
from ..replay.elements import Record, ReportDetails
from ..tracking.camera import Camera
from ..tracking.check import Finding, Verdict
from ..tracking.footage import WHOLE_CLIP, Decimation
from ..tracking.surface_marks import FaceNumbers
from ..tracking.track import ABSENT, Track
from .csv_and_json import read_json, write_json
from .fit_records import read_fit, write_fit
from .measured_throw import TrackedThrow, read_measured_throw, write_measured_throw
from .provenance import as_tables
from .scene import Scene, recorded_scene
from .settings import SceneError
from .throw_records import (
    read_simulated,
    read_track,
    write_bounces,
    write_faces,
    write_simulated,
    write_track,
    write_vertices,
)

FORMAT = 1
"""Version of the folder."""
HANDED_ON = ("track.csv", "bounces.csv", "simulated.csv", "fit.json")
"""Tables that the report contains as well."""


@dataclass(frozen=True, eq=False)
class AnalysedThrow:
    """One throw, measured and modelled, with what it was made from."""

    record: Record
    """What replays and reports draw: die, tracks, throw, fit."""
    details: ReportDetails
    """Poses of single frames, checks, and the origin of the result, as in `provenance.json`."""
    scene: Scene
    face_numbers: tuple[int | None, ...]
    """Read from each face in the scene's order; None where it was not read."""
    decimation: Decimation = WHOLE_CLIP
    """The part of the footage that was used."""
    folder: Path | None = None
    """Where it is saved; None if it is not."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Time of each stage [s]."""

    @property
    def result(self) -> Fit:
        """The fit: parameters with intervals, initial conditions, effects, messages."""
        assert self.record.fit is not None
        return self.record.fit

    @property
    def track(self) -> Track:
        """The measured poses, smoothed within each flight."""
        return self.record.track

    @property
    def throw(self) -> Throw:
        """The measured throw: flights with covariances, joined by impacts."""
        return self.record.measured

    @property
    def model(self) -> Throw | None:
        """The model's throw through the fitted bounces; None where nothing could be fitted."""
        return self.result.throw

    @property
    def notices(self) -> tuple[str, ...]:
        """Reservations about the footage, one sentence each."""
        return self.record.notices


def write_values(folder: Path, analysis: AnalysedThrow) -> None:
    """The values of an analysis: tables, fit, and `analysis.json`."""
    record, frames = analysis.record, analysis.details.frames
    assert frames is not None
    write_tracked(folder, record.track, TrackedThrow(frames, record.measured, record.die, analysis.face_numbers))
    write_fit(folder / "fit.json", analysis.result)
    write_simulated(folder / "simulated.csv", record.simulated or _nothing(record.track))
    write_json(folder / "analysis.json", _table(analysis))


def result_tables(folder: Path) -> dict[str, str]:
    """The contents of the folder's tables that its report hands on."""
    return {name: (folder / name).read_text(encoding="utf-8") for name in HANDED_ON}


def write_tracked(folder: Path, smoothed: Track, tracked: TrackedThrow) -> None:
    """The files of the tracking stage."""
    numbers, solid = tracked.face_numbers, tracked.die.solid
    # Where all were read, the faces are in their order.
    complete = FaceNumbers(numbers, 1.0, "").complete
    write_vertices(folder / "vertices.csv", solid)
    write_track(folder / "track.csv", smoothed)
    write_track(folder / "track_frames.csv", tracked.frames)
    write_measured_throw(folder / "track_frames.csv", tracked)
    write_bounces(folder / "bounces.csv", tracked.throw.impacts)
    write_faces(folder / "faces.csv", solid, tuple(range(1, len(numbers) + 1)) if complete else numbers)


def read_analysis(folder: Path) -> AnalysedThrow:
    """The analysis of a folder, without its clip. Raises FileNotFoundError, and ValueError with the file for what is none."""
    if not (folder / "analysis.json").exists():
        raise FileNotFoundError(f"{folder} has no analysis.json; wanted a folder that analyze or Analysis.save wrote")
    path = folder / "analysis.json"
    data, origin = read_json(path), read_json(folder / "provenance.json")
    if data.get("format") != FORMAT:
        raise InputError(
            f"{path}: format {data.get('format')}; this version reads {FORMAT}: load it with the one that wrote it"
        )
    scene = _scene_of(origin, folder)
    frames = read_track(folder / "track_frames.csv", scene.table.in_model.gravity_m_s2, turning_of(scene.die))
    tracked = read_measured_throw(folder / "track_frames.csv", frames, scene.die, scene.rounding)
    if tracked is None:
        raise FileNotFoundError(f"{folder} has no track_frames_throw.npz; wanted a whole folder of analyze")
    fit, table = read_fit(folder / "fit.json"), scene.table.in_model
    smoothed = read_track(folder / "track.csv", table.gravity_m_s2, turning_of(tracked.die))
    until_s = float(tracked.frames.time_s[-1])
    fit = replace(fit, throw=throw_of_fit(fit, tracked.die, table, until_s))
    try:
        decimation = Decimation(data["every"], data["shrink"])
        record = Record(
            title=data["title"],
            die=tracked.die,
            track=smoothed,
            measured=tracked.throw,
            fps=data["fps"],
            camera=None if data["camera"] is None else _camera(data["camera"]),
            fit=fit,
            simulated=read_simulated(folder / "simulated.csv") if fit.throw is not None else None,
            estimates=tuple(_estimate(one) for one in data["estimates"]),
            notices=tuple(data["notices"]),
        )
        findings = tuple(_finding(one) for one in data["findings"])
        numbers = tuple(data["face_numbers"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: {error!r}; wanted the analysis.json that analyze writes") from error
    return AnalysedThrow(
        record,
        ReportDetails(tracked.frames, findings, origin, result_tables(folder)),
        scene,
        numbers,
        decimation,
        folder,
        dict(origin.get("timings_s", {})),
    )


def _table(analysis: AnalysedThrow) -> dict[str, Any]:
    """The contents of `analysis.json`."""
    record = analysis.record
    return {
        "format": FORMAT,
        "title": record.title,
        "fps": record.fps,
        "notices": list(record.notices),
        "findings": [{**as_tables(one), "verdict": one.verdict.name} for one in analysis.details.findings],
        "estimates": [
            {
                "bounces": one.bounces,
                "t_s": one.time_s,
                "chi": asdict(one.chi),
                "face_odds": None if one.face_odds is None else {str(k): share for k, share in one.face_odds.items()},
            }
            for one in record.estimates
        ],
        "camera": None if record.camera is None else as_tables(record.camera),
        "face_numbers": list(analysis.face_numbers),
        "every": analysis.decimation.every,
        "shrink": analysis.decimation.shrink,
    }


def _scene_of(origin: Mapping[str, Any], folder: Path) -> Scene:
    """The scene, by its text in the provenance. Raises ValueError where that is no scene, or a file that it needs is gone."""
    understood = origin.get("understood", {})
    try:
        return recorded_scene(understood["text"], Path(origin["folder"], understood["path"]))
    except (KeyError, OSError, SceneError) as error:
        raise InputError(f"{folder / 'provenance.json'}: its scene cannot be read again: {error}") from error


def _nothing(track: Track) -> Track:
    """A track with the rows of another and no poses."""
    n = len(track)
    nothing = np.full((n, 3), np.nan), np.full((n, 4), np.nan), np.full((n, 6, 6), np.nan)
    return Track(track.frame, track.time_s, *nothing, np.full(n, ABSENT))


def _camera(table: Mapping[str, Any]) -> Camera:
    arrays = {name: np.array(table[name], float) for name in ("matrix", "distortion", "rotation", "translation_m")}
    return Camera(table["width_px"], table["height_px"], **arrays)


def _estimate(table: Mapping[str, Any]) -> Estimate:
    odds = table["face_odds"]
    shares = None if odds is None else {int(face): float(share) for face, share in odds.items()}
    return Estimate(table["bounces"], table["t_s"], Parameter(**table["chi"]), shares)


def _finding(table: Mapping[str, Any]) -> Finding:
    return Finding(table["name"], Verdict[table["verdict"]], table["measured"], table["advice"], table["values"])
