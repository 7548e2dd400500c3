"""Predictions: from the frames before some instant to the last frame, with the parameters of a fit.

Beside each CSV a JSON of the same name holds the frames in use, the error of the prediction, the odds of each face
bounce by bounce, and the bounce after which the face is decided (`decided`); NAME_covariance.npy the covariances of the poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...files.analysis_folder import AnalysedThrow
from ...files.csv_and_json import write_json
from ...files.fit_records import read_errors, read_parameters, state_table
from ...files.measured_throw import read_measured_throw, throw_path
from ...files.outputs import whole_file, whole_folder
from ...files.provenance import Stopwatch, provenance_table, write_provenance
from ...files.scene import Scene
from ...files.throw_records import covariance_path, read_track, write_covariances, write_simulated
from ...fitting.predict import (
    Decision,
    FaceOdds,
    ReleaseState,
    decide,
    first_bounce_row,
    predict_track,
    release_before,
    with_covariances,
)
from ...fitting.results import STATE_NAMES, Misfit, Parameter, ParameterCovariance
from ...fitting.throw import Physics, physics_of_fit
from ...model.die import Die
from ...model.errors import InputError
from ...model.laws import Restitution, Table
from ...model.rotations import angle_between, continuous_sign
from ...model.throw import turning_of
from ...runs import Progress, RunError, silent
from ...tracking.track import Track

FIRST_BOUNCE = "first-bounce"


@dataclass(frozen=True, eq=False)
class Prediction:
    """The prediction of one throw."""

    track: Path
    row: int
    """Row of the track: the first frame that the state does not use."""
    release: ReleaseState
    simulated: Track
    position_error_m: float
    """Mean over the frames from `row` on; NaN if none has a pose."""
    rotation_error_rad: float
    """The same."""
    decision: Decision | None
    """None if no odds were asked for."""


def predict_tracks(
    track_paths: Sequence[Path],
    scene: Scene,
    fit_path: Path,
    out: Path,
    *,
    from_frame: str,
    draws: int,
    force: bool = False,
    progress: Progress = silent,
    command: tuple[str, ...] = (),
) -> tuple[tuple[Prediction, ...], tuple[str, ...]]:
    """Predict every track from `from_frame` on, a frame number or FIRST_BOUNCE, and write the predictions.

    One track: `out` is a CSV, with a JSON beside it, which holds the provenance. Several: a folder with both for each, and
    `provenance.json`. `command` is the command line that it states. Returns the predictions and
    a sentence for each track that is left out. Raises RunError if no track can be predicted,
    ValueError for a file that is no fit or a frame that is no number.
    """
    law = read_law(fit_path)
    physics_of(law, scene.die, scene.table.in_model)  # refuses what concerns every track
    if from_frame != FIRST_BOUNCE and not from_frame.isdecimal():
        raise InputError(f"--from-frame {from_frame}: wanted a frame number, or {FIRST_BOUNCE}")
    names = [path.stem for path in track_paths]
    if len(set(names)) < len(names):
        raise InputError(
            f"two tracks are called {max(names, key=names.count)}: wanted names that differ, one file each"
        )
    inputs = (*scene.settings_paths, fit_path, *track_paths, *_beside(track_paths))
    watch = Stopwatch()
    predicted = partial(_predicted, track_paths, scene, law, from_frame, draws, progress)
    if len(track_paths) == 1:
        beside, covariances = out.with_suffix(".json"), covariance_path(out)
        with (
            whole_file(out, force=force, inputs=inputs) as csv_file,
            whole_file(beside, force=force, inputs=inputs) as json_file,
            whole_file(covariances, force=force, inputs=inputs) as npy_file,
        ):
            with watch.stage("predict"):
                made, left_out = predicted()
            origin = provenance_table(command=command, understood=scene, seconds=watch.seconds, inputs=inputs)
            _write(made[0], csv_file, json_file, npy_file, provenance=origin)
    else:
        with whole_folder(out, force=force, inputs=inputs) as folder:
            with watch.stage("predict"):
                made, left_out = predicted()
            for one in made:
                csv = folder / f"{one.track.stem}.csv"
                _write(one, csv, csv.with_suffix(".json"), covariance_path(csv))
            write_provenance(folder, command=command, understood=scene, seconds=watch.seconds, inputs=inputs)
    return tuple(made), tuple(left_out)


def _beside(track_paths: Sequence[Path]) -> list[Path]:
    """The files that belong to the tracks and are read with them."""
    return [path for track in track_paths for path in (covariance_path(track), throw_path(track)) if path.exists()]


def _predicted(
    paths: Sequence[Path],
    scene: Scene,
    law: Law,
    from_frame: str,
    draws: int,
    progress: Progress,
) -> tuple[list[Prediction], list[str]]:
    """Every track that can be predicted, and a sentence for each that cannot."""
    made, left_out = [], []
    for k, path in enumerate(paths):
        progress("Predicting the throws", k, len(paths))
        try:
            made.append(predict(path, scene, law, from_frame, draws))
        except ValueError as error:
            left_out.append(f"{path} is left out: {str(error).removeprefix(f'{path}: ')}.")
    if not made:
        raise RunError(" ".join(left_out))
    return made, left_out


def predict(path: Path, scene: Scene, law: Law, from_frame: str, draws: int) -> Prediction:
    """The prediction of one throw, of the die as it was tracked where that is known beside the track.

    Raises ValueError, with the reason, for a track that cannot be predicted from there."""
    table = scene.table.in_model
    track = read_track(path, table.gravity_m_s2, turning_of(scene.die))
    tracked = read_measured_throw(path, track, scene.die, scene.rounding)
    if tracked is not None:
        track = replace(track, turning=turning_of(tracked.die))
    physics = physics_of(law, scene.given_die() if tracked is None else tracked.die, table)
    row = first_bounce_row(track, physics.die) if from_frame == FIRST_BOUNCE else _row_of(track, int(from_frame))
    release = release_before(track, physics.body, row)
    simulated = with_covariances(
        predict_track(physics, track, release), physics, release, law.parameters, law.covariance, law.misfit
    )
    compared = track.tracked & simulated.tracked
    compared[:row] = False
    off = track.position_m[compared] - simulated.position_m[compared]
    turned_rad = angle_between(simulated.quaternion[compared], track.quaternion[compared])
    decision = decide(physics, law.parameters, track, row, law.covariance, draws=draws) if draws else None
    return Prediction(
        path,
        row,
        release,
        simulated,
        float(np.linalg.norm(off, axis=1).mean()) if compared.any() else float("nan"),
        float(turned_rad.mean()) if compared.any() else float("nan"),
        decision,
    )


def predicted_track(analysis: AnalysedThrow, from_frame: int | None) -> Track:
    """The poses that the fit of an analysis predicts from the frames before `from_frame`, or before the first bounce, with
    covariances. Raises ValueError where these determine no state."""
    fit, die, frames = analysis.result, analysis.record.die, analysis.details.frames
    assert frames is not None
    if fit.parameters["chi"].value is None:
        raise InputError("chi was not determined; wanted a fit through one bounce or more")
    physics = physics_of_fit(fit, die, analysis.scene.table.in_model)
    row = first_bounce_row(frames, die) if from_frame is None else _row_of(frames, from_frame)
    release = release_before(frames, physics.body, row)
    covariance = None
    if fit.covariance is not None:
        names = fit.covariance_names[len(STATE_NAMES) :]
        covariance = ParameterCovariance(names, fit.covariance[len(STATE_NAMES) :, len(STATE_NAMES) :])
    return with_covariances(
        predict_track(physics, frames, release), physics, release, dict(fit.parameters), covariance, None
    )


@dataclass(frozen=True)
class Law:
    """What a fit says about throws."""

    path: Path
    """The file of the fit."""
    parameters: dict[str, Parameter]
    restitution: Restitution
    covariance: ParameterCovariance | None
    """Of the parameters; None where the fit has none."""
    misfit: Misfit | None
    """What the law misses, in the fit of many throws."""


def read_law(fit_path: Path) -> Law:
    """The law of a fit. Raises ValueError for a file that is no fit, or lacks χ."""
    parameters, restitution = read_parameters(fit_path)
    if "chi" not in parameters:
        raise InputError(f"{fit_path}: parameters.chi is missing; wanted the fit.json that a fit writes")
    return Law(fit_path, parameters, restitution, *read_errors(fit_path))


def physics_of(law: Law, die: Die, table: Table) -> Physics:
    """The throws of a die over a table by the law of a fit. Raises ValueError for a parameter that throws do not have."""
    physics = Physics(die, table, {"chi": 0.0}, restitution=law.restitution)
    values = {}
    for name, parameter in law.parameters.items():
        try:
            low, high = physics.bounds(name)
        except KeyError:
            raise InputError(f"{law.path}: parameters.{name} is not a parameter of a throw") from None
        assert parameter.value is not None
        if not low <= parameter.value <= high:
            raise InputError(f"{law.path}: parameters.{name}.value = {parameter.value}; wanted {low:g} to {high:g}")
        values[name] = float(parameter.value)
    return physics.with_values(**values)


def _row_of(track: Track, frame: int) -> int:
    """The first row of a track with this frame number or a later one."""
    later = np.flatnonzero(track.frame >= frame)
    if not len(later):
        raise InputError(
            f"--from-frame {frame} lies behind the last frame, {int(track.frame[-1])}; wanted a frame of the track"
        )
    return int(later[0])


def _write(made: Prediction, csv: Path, beside: Path, covariances: Path, **more: object) -> None:
    write_simulated(csv, _continuous(made.simulated))
    write_covariances(covariances, made.simulated)
    write_json(beside, {**prediction_table(made), **more})


def _continuous(track: Track) -> Track:
    return Track(
        track.frame, track.time_s, track.position_m, continuous_sign(track.quaternion), track.covariance, track.status
    )


def prediction_table(made: Prediction) -> dict[str, Any]:
    """A prediction as JSON."""
    release, decision = made.release, made.decision
    return {
        "track": made.track,
        "from_frame": int(made.simulated.frame[made.row]),
        "frames_used": len(release.rows),
        "sigma_m": release.sigma_m,
        "sigma_rad": release.sigma_rad,
        "state": state_table(release.state, release.covariance),
        "position_error_m": made.position_error_m,
        "rotation_error_rad": made.rotation_error_rad,
        "odds": None if decision is None else [_odds_table(step) for step in decision.steps],
        "decided": None
        if decision is None
        else {"face": decision.face, "bounces": decision.bounces, "t_s": decision.time_s},
    }


def _odds_table(step: FaceOdds) -> dict[str, Any]:
    return {
        "bounces": step.bounces,
        "t_s": step.time_s,
        "frames": step.frames,
        "face_odds": {str(face): odds for face, odds in step.odds.items()},
        "undecided": step.undecided,
    }


def summary(made: Sequence[Prediction], die: Die) -> list[str]:
    """The outcome in a few lines."""
    position = 100.0 * np.nanmean([m.position_error_m for m in made]) / die.solid.edge_m
    turned = np.degrees(np.nanmean([m.rotation_error_rad for m in made]))
    error = f"{position:.3g} % of the edge and {turned:.3g} degrees"
    if len(made) > 1:
        lines = [f"{len(made)} throws predicted; mean error over throws and frames: {error}"]
    else:
        frame = made[0].simulated.frame[made[0].row]
        lines = [f"throw predicted from frame {frame} on; mean error over its frames: {error}"]
    decisions = [m.decision for m in made if m.decision is not None]
    if len(made) == 1 and decisions:
        lines += _odds_lines(decisions[0])
    elif decisions:
        before = sum(d.bounces == 0 for d in decisions)
        lines.append(f"the landing face is decided before the first bounce in {before} of {len(decisions)} throws")
    return lines


def _odds_lines(decision: Decision) -> list[str]:
    lines = ["after bounces   t [s]    odds of the faces"]
    for step in decision.steps:
        odds = "  ".join(f"{face}: {share:.2f}" for face, share in step.odds.items() if share > 0.0)
        lines.append(f"{step.bounces:>13}   {step.time_s:.4f}   {odds}")
    if decision.face is None:
        lines.append("no face becomes certain before the last frame")
    else:
        when = f"after bounce {decision.bounces}" if decision.bounces else "before the first bounce"
        lines.append(f"face {decision.face} is decided {when}")
    return lines
