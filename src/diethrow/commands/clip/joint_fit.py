"""Joint fit of several tracks of one die on one table, written to one folder.

Its `fit.json` holds `parameters`, `law`, `effects`, `chi_scatter`, the `minima` of the cost, the `covariance` of the parameters,
the `misfit` of the law, `throws` with one entry a track, and `messages`.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...files.csv_and_json import write_json
from ...files.fit_records import effects_table, errors_tables, law_table, parameters_table
from ...files.outputs import whole_folder
from ...files.provenance import Stopwatch, write_provenance
from ...files.scene import Scene
from ...files.throw_records import covariance_path, read_track, write_vertices
from ...fitting.dataset import Entry, JointFit, PredictedThrow, entry_of, fit_jointly
from ...model.die import Die
from ...model.throw import turning_of
from ...runs import Progress, RunError, silent


@dataclass(frozen=True, eq=False)
class FitOfMany:
    """A joint fit as it was written to `folder`."""

    folder: Path
    fit: JointFit
    left_out: tuple[str, ...]
    """One sentence for each track that is not in the fit."""
    seconds: dict[str, float]


def fit_tracks(
    track_paths: Sequence[Path],
    scene: Scene,
    out: Path,
    *,
    force: bool = False,
    threads: int = 1,
    executor: Executor | None = None,
    progress: Progress = silent,
    command: tuple[str, ...] = (),
) -> FitOfMany:
    """Fit the parameters that several tracks share, and write them to the folder `out`.

    With an `executor`, one of its workers makes the fit on `threads` threads; the numbers are the same.

    Tracks without a bounce, with times that do not increase or with too few frames are left out and named. Raises
    RunError if fewer than two remain, SceneError for a scene that cannot be fitted, OutputExistsError for a folder that
    exists.
    """
    watch = Stopwatch()
    gravity_m_s2 = scene.still_table().gravity_m_s2
    die = scene.given_die()
    inputs = (*scene.settings_paths, *track_paths, *(p for p in map(covariance_path, track_paths) if p.exists()))
    with whole_folder(out, force=force, inputs=inputs) as folder:
        with watch.stage("read"):
            entries, left_out = _read(track_paths, die, gravity_m_s2, progress)
        if len(entries) < 2:
            error = RunError(
                f"{len(entries)} of {len(track_paths)} tracks can be fitted; wanted at least two for a joint fit"
            )
            for sentence in left_out:
                error.add_note(sentence)
            raise error
        with watch.stage("fit"):
            if executor is None:

                def steps(done: int, total: int) -> None:
                    progress("Fitting all throws", done, total)

                fit = fit_jointly(entries, die, threads=threads, progress=steps)
            else:
                progress("Fitting all throws", 0, 0)
                fit = executor.submit(fit_jointly, entries, die, threads=threads).result()
        write_vertices(folder / "vertices.csv", die.solid)
        write_json(folder / "fit.json", joint_tables(fit, left_out))
        write_provenance(folder, command=command, understood=scene, inputs=inputs, seconds=watch.seconds)
    return FitOfMany(Path(out), fit, left_out, watch.seconds)


def joint_tables(fit: JointFit, left_out: Sequence[str] = ()) -> dict[str, Any]:
    """The joint fit as JSON."""
    return {
        "parameters": parameters_table(fit.parameters),
        "law": law_table(fit.parameters),
        "effects": {
            "chosen": [effect.name for effect in fit.chosen],
            "evidence": {effect.name: effect.evidence for effect in fit.chosen},
            "considered": effects_table(fit.considered),
        },
        "chi_scatter": fit.chi_scatter,
        "minima": [{"cost_m": minimum.cost_m, "parameters": dict(minimum.physics.values)} for minimum in fit.minima],
        **errors_tables(fit.covariance, fit.misfit),
        "throws": [_throw_table(throw) for throw in fit.throws],
        "left_out": list(left_out),
        "messages": [*fit.messages, *left_out],
    }


def _throw_table(throw: PredictedThrow) -> dict[str, Any]:
    return {
        "track": throw.name,
        "first_bounce_frame": throw.first_bounce_frame,
        "frames_before": throw.frames_before,
        "frames_after": throw.frames_after,
        "position_error_m": throw.position_error_m,
        "rotation_error_rad": throw.rotation_error_rad,
        "chi": throw.chi,
    }


def _read(
    paths: Sequence[Path], die: Die, gravity_m_s2: float, progress: Progress
) -> tuple[list[Entry], tuple[str, ...]]:
    entries: list[Entry] = []
    left_out: list[str] = []
    for k, (path, name) in enumerate(zip(paths, _names(paths), strict=True)):
        progress("Reading the tracks", k, len(paths))
        try:
            entries.append(entry_of(name, read_track(path, gravity_m_s2, turning_of(die)), die))
        except ValueError as error:
            reason = str(error).removeprefix(f"{path}: ").removeprefix(f"{name}: ")
            left_out.append(f"{path} is left out: {reason}.")
    return entries, tuple(left_out)


def _names(paths: Sequence[Path]) -> list[str]:
    """Of the files or, where these have the same name in several folders, of the folders."""
    stems = [path.stem for path in paths]
    return stems if len(set(stems)) == len(stems) else [path.resolve().parent.name for path in paths]
