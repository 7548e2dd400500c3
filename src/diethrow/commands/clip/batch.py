"""`diethrow batch`: many scenes, each analysed into its own folder, in any order and on any machine.

A clip is finished when its folder exists: folders appear whole (`files.outputs`), and their `provenance.json` states which
version made them from which bytes. No other state is kept, so the same command continues a batch that was stopped or killed.
`results.csv` and `failures.csv` are rewritten as clips are finished, in the order of the scenes, and hold the same numbers
wherever the work is done.
"""

from __future__ import annotations

import csv
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from dataclasses import dataclass, fields
from itertools import chain
from pathlib import Path
from typing import Any, Literal

from ... import __version__
from ...executors import Processes, WorkerLostError, cores
from ...files.csv_and_json import read_json
from ...files.outputs import OutputExistsError, OutputPlaceError, locked, refuse_existing, whole_file
from ...files.provenance import InputChangedError, files_read
from ...files.scene import Scene, read_scene
from ...files.settings import SceneError
from ...model.errors import InputError
from .run_options import USUAL_OPTIONS, RunOptions, Stage

ATTEMPTS = 3
"""A clip fails after its worker has died this often: the clip may be the cause."""
TRACK_FILES = ("provenance.json", "track.csv", "bounces.csv")
"""Files that every finished folder holds."""
TABLES_EVERY_S = 2.0
"""Shortest time [s] between two updates of the tables; the final tables are always written."""

LOGGER = logging.getLogger("diethrow")

Kind = Literal["scene", "clip", "output", "worker", "error"]


@dataclass(frozen=True)
class Task:
    """One scene, and the folder of its results."""

    scene: Path
    folder: Path
    stage: Stage
    options: RunOptions = USUAL_OPTIONS
    allow_outside: bool = False
    """Whether files outside the scene's folder are allowed."""

    @property
    def command(self) -> tuple[str, ...]:
        """The command that does the same for this scene alone."""
        outside = ("--allow-outside",) if self.allow_outside else ()
        own = self.options.words(self.stage)
        return ("diethrow", self.stage, str(self.scene), "--out", str(self.folder), *outside, *own)


@dataclass(frozen=True)
class Result:
    """A row of results.csv; None for what the stage does not compute or could not determine."""

    scene: str
    folder: str
    frames: int
    tracked: int
    bounces: int
    bounces_fitted: int | None
    chi: float | None
    chi_low: float | None
    chi_high: float | None
    level: float | None
    residual_rms: float | None
    landed_face: int | None
    verdict: str
    """`fitted`, `fitted, no interval`, `chi not determined`, or `tracked` without a fit."""
    seconds: float
    """Working time [s]."""


@dataclass(frozen=True)
class Failure:
    """A row of failures.csv."""

    scene: str
    kind: Kind
    """Where the cause lies: the scene file, the clip, the output folder, the workers, or this program."""
    reason: str
    """One sentence."""
    attempts: int = 1


@dataclass(frozen=True)
class Standing:
    """Progress of a batch."""

    done: int
    """Clips that need no more work, including failed ones."""
    failed: int
    total: int
    left_s: float | None
    """Estimated time left [s], from the clips done so far; None before the first."""
    last: str
    """The scene finished last."""


@dataclass(frozen=True)
class Batch:
    """A whole batch, as it was written to `folder`."""

    folder: Path
    results: tuple[Result, ...]
    failures: tuple[Failure, ...]
    kept: int
    """Clips finished earlier and not analysed again."""


def run_batch(
    scenes: Sequence[Path],
    out: Path,
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    stage: Stage = "analyze",
    options: RunOptions = USUAL_OPTIONS,
    allow_outside: bool = False,
    progress: Callable[[Standing], None] = lambda standing: None,
) -> Batch:
    """Analyse every scene into its own folder in `out`, and write one table of results and one of failures.

    `executor` does the work: any of `concurrent.futures` whose workers see the same files; by default `workers` local processes
    (one per core). A repeated call analyses what is missing, what failed, and what another version, other options or other
    bytes made. A clip whose worker dies is tried by another worker.

    Raises ValueError without a scene, OutputBusyError if another batch writes to `out`, OutputExistsError if `out` is a file, and
    OutputPlaceError if it cannot be written.
    """
    if not scenes:
        raise InputError("no scenes: wanted one scene file or more")
    out = Path(out).resolve()
    tasks = tasks_of(scenes, out, stage, options, allow_outside)
    if not out.is_dir():
        refuse_existing(out)
    with locked(out):
        out.mkdir(parents=True, exist_ok=True)
        ledger = _Ledger(out, tasks, progress)
        # Clips without a folder come first: the bytes of the others are compared while the workers are busy with these.
        made = [task for task in tasks if task.folder.exists()]
        known = set(made)
        new = [task for task in tasks if task not in known]
        others = (task for task in made if not ledger.found(task))
        ledger.write()
        if executor is not None:
            ledger.take(_worked(chain(new, others), executor))
        else:
            with Processes(min(workers or cores(), len(tasks))) as processes:
                ledger.take(_worked(chain(new, others), processes))
        ledger.write()
    return ledger.batch()


def tasks_of(
    scenes: Sequence[Path],
    out: Path,
    stage: Stage = "analyze",
    options: RunOptions = USUAL_OPTIONS,
    allow_outside: bool = False,
) -> list[Task]:
    """One task per scene. A folder is named after that of its scene, or after the file if that is not `scene.toml`; equal names
    are preceded by the names of the folders above."""
    paths = list(dict.fromkeys(Path(scene).absolute() for scene in scenes))
    parts = [(*path.parent.parts[1:], *(() if path.name == "scene.toml" else (path.stem,))) for path in paths]
    depth = dict.fromkeys(parts, 1)
    while True:
        names = {part: "_".join(part[-depth[part] :]) or "scene" for part in parts}
        twice = {name for name, count in Counter(names.values()).items() if count > 1}
        deeper = [part for part in parts if names[part] in twice and depth[part] < len(part)]
        if not deeper:
            break
        for part in deeper:
            depth[part] += 1
    return [
        Task(path, out / names[part], stage, options, allow_outside) for path, part in zip(paths, parts, strict=True)
    ]


def is_finished(task: Task) -> bool:
    """Whether the folder of a task can be read, and was made by this version, stage and options from the present bytes."""
    wanted = (*TRACK_FILES, *(("fit.json",) if task.stage == "analyze" else ()))
    if not all((task.folder / name).is_file() for name in wanted):
        return False
    origin = _Origin.of(task.folder)
    own = task.options.words(task.stage)
    if origin is None or (origin.version, origin.stage, origin.options) != (__version__, task.stage, own):
        return False
    from .track import input_paths

    try:
        result_of(task)
    except (AttributeError, KeyError, TypeError, ValueError, OSError, csv.Error):
        return False  # damaged: analysing it again mends it
    try:
        now = files_read(input_paths(read_scene(task.scene, allow_outside=task.allow_outside)))
    except (SceneError, OSError):
        return False  # analysing it again reports what is wrong
    return tuple(file.sha256 for file in now) == origin.digests


@dataclass(frozen=True)
class _Origin:
    """How a folder was made, by its provenance."""

    version: str
    stage: str
    options: tuple[str, ...]
    digests: tuple[str, ...]
    """SHA-256 of the inputs, in their order."""

    @classmethod
    def of(cls, folder: Path) -> _Origin | None:
        """None if the file does not state it."""
        try:
            origin = read_json(folder / "provenance.json")
            command = [str(word) for word in origin["command"]]
            options = tuple(command[command.index("--quality") :])
            digests = tuple(str(each["sha256"]) for each in origin["inputs"])
            return cls(str(origin["diethrow"]), command[1], options, digests)
        except (KeyError, TypeError, ValueError, IndexError):
            return None


def work(task: Task) -> Failure | None:
    """Analyse one clip in a worker; a failure is returned as a value, so that the batch continues."""
    from ...runs import RunError
    from .analyze import analyze
    from .track import track_only

    try:
        scene: Scene = read_scene(task.scene, allow_outside=task.allow_outside)
        options = task.options.arguments(task.stage)
        refuse_existing_of_others(task.folder)
        do = analyze if task.stage == "analyze" else track_only
        do(scene, task.folder, force=True, command=task.command, **options)
    except (OutputPlaceError, OutputExistsError) as error:
        return _failure(task, "output", error)
    except SceneError as error:
        return _failure(task, "scene", error)
    except (RunError, InputChangedError, OSError, ValueError) as error:
        return _failure(task, "clip", error)
    except Exception as error:  # a fault of this program on one clip must not stop the others
        error.add_note(type(error).__name__)
        return _failure(task, "error", error)
    return None


def refuse_existing_of_others(folder: Path) -> None:
    """Raises OutputExistsError for a folder that this program did not make; a batch replaces only its own."""
    if folder.exists() and not (folder / "provenance.json").is_file():
        raise OutputExistsError(
            f"{folder} exists and holds no results of diethrow; move it away, or choose another --out"
        )


def result_of(task: Task) -> Result:
    """The row of a finished clip, from the files in its folder."""
    folder = task.folder
    with (folder / "track.csv").open(newline="", encoding="utf-8") as file:
        statuses = [row["status"] for row in csv.DictReader(file)]
    with (folder / "bounces.csv").open(newline="", encoding="utf-8") as file:
        bounces = sum(1 for _ in csv.DictReader(file))
    origin = read_json(folder / "provenance.json")
    fit = read_json(folder / "fit.json") if task.stage == "analyze" else None
    chi = fit["parameters"]["chi"] if fit is not None else dict.fromkeys(("value", "low", "high", "level"))
    return Result(
        scene=str(task.scene),
        folder=folder.name,
        frames=len(statuses),
        tracked=statuses.count("tracked"),
        bounces=bounces,
        bounces_fitted=None if fit is None else fit["bounces_fitted"],
        chi=chi["value"],
        chi_low=chi["low"],
        chi_high=chi["high"],
        level=chi["level"],
        residual_rms=None if fit is None else fit["residual_rms"],
        landed_face=None if fit is None else fit["landed_face"],
        verdict="tracked" if fit is None else _verdict(chi),
        seconds=round(sum(origin["timings_s"].values()), 3),
    )


def write_table(path: Path, kind: type[Any], rows: Sequence[Any]) -> None:
    """A CSV table with one frozen value per row; the file is replaced in one step."""
    names = [part.name for part in fields(kind)]
    with whole_file(path, force=True) as aside, aside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(["" if (v := getattr(row, name)) is None else v for name in names] for row in rows)


class _Ledger:
    """State and tables of a batch."""

    def __init__(self, out: Path, tasks: Sequence[Task], progress: Callable[[Standing], None]) -> None:
        self._out, self._tasks, self._progress = out, tasks, progress
        self._known: dict[Task, Result | Failure] = {}
        self._kept = 0
        self._fresh = 0
        self._begin = time.monotonic()
        self._written = -TABLES_EVERY_S

    def found(self, task: Task) -> bool:
        """Whether a clip is finished already; then it is entered."""
        if not is_finished(task):
            return False
        self._known[task] = result_of(task)
        self._kept += 1
        self._report(task)
        return True

    def take(self, outcomes: Iterator[tuple[Task, Failure | None]]) -> None:
        """Enter outcomes as they arrive, and update the tables."""
        self._begin = time.monotonic()
        for task, failure in outcomes:
            self._known[task] = outcome = failure or result_of(task)
            self._fresh += 1
            # Workers may be other machines; what they log stays there.
            if isinstance(outcome, Result):
                LOGGER.info(
                    "%s: %s, %d bounces, %.3f s", outcome.folder, outcome.verdict, outcome.bounces, outcome.seconds
                )
            else:
                LOGGER.info("%s: failed: %s", task.folder.name, outcome.reason)
            if time.monotonic() - self._written > TABLES_EVERY_S:
                self.write()
            self._report(task)

    def write(self) -> None:
        """Both tables."""
        batch = self.batch()
        write_table(self._out / "results.csv", Result, batch.results)
        write_table(self._out / "failures.csv", Failure, batch.failures)
        self._written = time.monotonic()

    def batch(self) -> Batch:
        """Results and failures so far, in the order of the scenes."""
        known = [self._known[task] for task in self._tasks if task in self._known]
        results = tuple(each for each in known if isinstance(each, Result))
        return Batch(self._out, results, tuple(each for each in known if isinstance(each, Failure)), self._kept)

    def _report(self, task: Task) -> None:
        done, total = len(self._known), len(self._tasks)
        took = time.monotonic() - self._begin
        left_s = took / self._fresh * (total - done) if self._fresh else None
        failed = sum(isinstance(each, Failure) for each in self._known.values())
        self._progress(Standing(done, failed, total, left_s, str(task.scene)))


def _worked(tasks: Iterable[Task], executor: Executor) -> Iterator[tuple[Task, Failure | None]]:
    """Each task with its failure or None, in order of completion; a task whose worker died is submitted again."""
    running: dict[Future[Failure | None], Task] = {}
    losses: Counter[Task] = Counter()

    def begin(task: Task) -> Failure | None:
        try:
            running[executor.submit(work, task)] = task
        except (BrokenExecutor, RuntimeError) as error:
            return _failure(task, "worker", error, losses[task] + 1)
        return None

    def outcome(future: Future[Failure | None], task: Task) -> tuple[bool, Failure | None]:
        """Whether the task is finished, and its failure or None."""
        try:
            return True, future.result()
        except (WorkerLostError, BrokenExecutor, CancelledError) as error:
            lost: Exception = error
        except Exception as error:
            # Dask's error for a task whose workers die; compared by name, because Dask may not be installed.
            if type(error).__name__ != "KilledWorker":
                raise
            lost = error
        losses[task] += 1
        if losses[task] < ATTEMPTS:
            failure = begin(task)
            return failure is not None, failure
        return True, _failure(task, "worker", lost, losses[task])

    try:
        for task in tasks:
            if failure := begin(task):
                yield task, failure
        while running:
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                task = running.pop(future)
                finished, failed = outcome(future, task)
                if finished:
                    yield task, failed
    finally:
        for future in running:
            future.cancel()


def _failure(task: Task, kind: Kind, error: Exception, attempts: int = 1) -> Failure:
    notes = getattr(error, "__notes__", [])
    reason = " ".join(" ".join([*map(str, notes), str(error)]).split()) or type(error).__name__
    return Failure(str(task.scene), kind, reason, attempts)


def _verdict(chi: dict[str, Any]) -> str:
    if chi["value"] is None:
        return "chi not determined"
    return "fitted" if chi["low"] is not None and chi["high"] is not None else "fitted, no interval"
