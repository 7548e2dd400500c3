"""A batch analyses every clip once, gives the same numbers on every executor, and survives kills of itself or its workers."""

from __future__ import annotations

import csv
import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import diethrow.commands.clip.batch
import diethrow.files.outputs
from diethrow.cli.app import app
from diethrow.commands.clip.batch import Batch, Standing, Task, is_finished, run_batch, tasks_of
from diethrow.commands.clip.run_options import RunOptions
from diethrow.executors import Processes, WorkerLostError
from diethrow.files.outputs import OutputBusyError, OutputExistsError, locked

SAMPLE = Path(__file__).parents[2] / "data_samples" / "cube_wood_photron"


class InLine(Executor):
    """An executor that makes each call at once in this process; for the calls in `lose` it reports a dead worker."""

    def __init__(self, lose: Callable[[int], bool] = lambda number: False) -> None:
        self.calls = 0
        self._lose = lose

    def submit(self, fn, /, *args, **kwargs):  # type: ignore[no-untyped-def]
        future: Future = Future()
        self.calls += 1
        if self._lose(self.calls):
            future.set_exception(WorkerLostError("the worker process died (SIGKILL)"))
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def clip(folder: Path, frames: tuple[int, int] = (0, 40)) -> Path:
    """The scene of a copy of the sample, over some of its frames."""
    shutil.copytree(SAMPLE, folder)
    scene = folder / "scene.toml"
    scene.write_text(scene.read_text().replace("[clip]\n", f"[clip]\nframes = [{frames[0]}, {frames[1]}]\n"))
    return scene


def broken_clip(folder: Path) -> Path:
    """A scene whose pixels are cut off within the first frame."""
    scene = clip(folder)
    (folder / "clip.mraw").write_bytes(b"\0" * 100)
    return scene


FAST = RunOptions("fast")


def track(scenes: list[Path], out: Path, executor: Executor | None = None, **more: object) -> Batch:
    return run_batch(scenes, out, executor=executor or InLine(), stage="track", options=FAST, **more)  # type: ignore[arg-type]


def numbers_in(folder: Path) -> dict[str, bytes]:
    """Every table of a batch; results without their durations."""
    files = sorted(file for file in folder.rglob("*") if file.suffix in (".csv", ".npy") and file.parent != folder)
    found = {str(file.relative_to(folder)): file.read_bytes() for file in files}
    with (folder / "results.csv").open(newline="") as table:
        rows = [{**row, "seconds": ""} for row in csv.DictReader(table)]
    return {**found, "results.csv": repr(rows).encode()}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two clips that can be tracked, and between them one that cannot."""
    root = tmp_path_factory.mktemp("clips")
    return [clip(root / "whole"), broken_clip(root / "broken"), clip(root / "part", (5, 25))]


@pytest.fixture(scope="module")
def done(scenes: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The finished batch of the scenes; tests do not change it."""
    out = tmp_path_factory.mktemp("done") / "out"
    track(scenes, out)
    return out


def test_a_batch_lists_results_and_failures_in_the_order_of_the_scenes(scenes: list[Path], done: Path) -> None:
    with (done / "results.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    assert [row["scene"] for row in rows] == [str(scenes[0]), str(scenes[2])]
    assert [(row["folder"], row["frames"], row["verdict"]) for row in rows] == [
        ("whole", "40", "tracked"),
        ("part", "20", "tracked"),
    ]
    with (done / "failures.csv").open(newline="") as table:
        (failure,) = csv.DictReader(table)
    assert (failure["scene"], failure["kind"]) == (str(scenes[1]), "scene")
    assert "clip.mraw: 100 bytes" in failure["reason"]
    assert sorted(path.name for path in done.iterdir()) == ["failures.csv", "part", "results.csv", "whole"]
    assert [path.name for path in done.parent.iterdir()] == ["out"]


def test_the_numbers_are_the_same_in_any_order_and_in_other_processes(
    scenes: list[Path], done: Path, tmp_path: Path
) -> None:
    with Processes(2) as processes:
        track(scenes, tmp_path / "processes", processes)
    assert numbers_in(tmp_path / "processes") == numbers_in(done)
    with ThreadPoolExecutor(2) as threads:
        track(scenes[::-1], tmp_path / "backwards", threads)
    backwards, forwards = numbers_in(tmp_path / "backwards"), numbers_in(done)
    assert backwards.pop("results.csv") != forwards.pop("results.csv")
    assert backwards == forwards


def test_clips_without_results_are_begun_before_the_bytes_of_others_are_compared(
    scenes: list[Path], done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, happened = tmp_path / "out", []
    shutil.copytree(done, out)
    shutil.rmtree(out / "part")
    batch_of = diethrow.commands.clip.batch
    compare, begin = batch_of.is_finished, InLine.submit
    monkeypatch.setattr(batch_of, "is_finished", lambda task: happened.append("compared") or compare(task))
    monkeypatch.setattr(InLine, "submit", lambda *call: happened.append("begun") or begin(*call))
    track(scenes, out, InLine())
    assert happened[0] == "begun"
    assert "compared" in happened
    assert numbers_in(out) == numbers_in(done)


def test_a_finished_clip_is_analysed_again_only_after_a_change(
    scenes: list[Path], done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    shutil.copytree(done, out)
    again = InLine()
    batch = track(scenes, out, again)
    assert (batch.kept, again.calls) == (2, 1)  # the failed one is tried again
    assert numbers_in(out) == numbers_in(done)

    whole = tasks_of(scenes, out, "track", FAST)[0]
    assert is_finished(whole)
    assert not is_finished(Task(whole.scene, whole.folder, "track"))
    assert not is_finished(Task(whole.scene, whole.folder, "analyze", FAST))
    for other in (replace(FAST, every=2), replace(FAST, shrink=2), replace(FAST, timing="as-filmed")):
        assert not is_finished(Task(whole.scene, whole.folder, "track", other))
    assert is_finished(Task(whole.scene, whole.folder, "track", replace(FAST, intervals="bootstrap", figures=True)))
    moved = tmp_path / "moved"
    shutil.copytree(scenes[0].parent, moved)
    assert is_finished(Task(moved / "scene.toml", whole.folder, "track", FAST))
    with (moved / "clip.mraw").open("r+b") as pixels:
        pixels.write(b"\1")
    assert not is_finished(Task(moved / "scene.toml", whole.folder, "track", FAST))
    monkeypatch.setattr(diethrow.commands.clip.batch, "__version__", "0.0.0")
    assert not is_finished(whole)


def test_a_folder_with_a_damaged_file_is_not_finished(scenes: list[Path], done: Path, tmp_path: Path) -> None:
    shutil.copytree(done, tmp_path / "out")
    whole = tasks_of(scenes, tmp_path / "out", "track", FAST)[0]
    shutil.copytree(whole.folder, tmp_path / "fitted")
    fitted = Task(whole.scene, tmp_path / "fitted", "analyze", FAST)
    origin = fitted.folder / "provenance.json"
    contents = json.loads(origin.read_text())
    contents["command"] = list(fitted.command)
    origin.write_text(json.dumps(contents))
    chi = {"value": 0.5, "low": 0.4, "high": 0.6, "level": 0.95}
    fit = json.dumps({"parameters": {"chi": chi}, "bounces_fitted": 2, "residual_rms": 1.0, "landed_face": 1})
    (fitted.folder / "fit.json").write_text(fit)
    assert is_finished(fitted)
    for damaged in (fit[: len(fit) // 2], "{}", ""):
        (fitted.folder / "fit.json").write_text(damaged)
        assert not is_finished(fitted)
    (whole.folder / "track.csv").write_text("frame\n1\n")
    assert not is_finished(whole)


def test_a_clip_whose_worker_dies_is_tried_again_and_fails_after_the_last_attempt(
    scenes: list[Path], tmp_path: Path
) -> None:
    dying_twice = InLine(lambda number: number <= 2)
    batch = track(scenes[:1], tmp_path / "twice", dying_twice)
    assert (len(batch.results), batch.failures, dying_twice.calls) == (1, (), 3)
    always = InLine(lambda number: True)
    (failure,) = track(scenes[:1], tmp_path / "always", always).failures
    assert (failure.kind, failure.attempts, always.calls) == ("worker", diethrow.commands.clip.batch.ATTEMPTS, 3)
    assert "SIGKILL" in failure.reason


def test_the_time_left_is_reported(scenes: list[Path], tmp_path: Path) -> None:
    reports: list[Standing] = []
    track(scenes, tmp_path / "out", progress=reports.append)
    assert [(standing.done, standing.total) for standing in reports] == [(1, 3), (2, 3), (3, 3)]
    assert reports[-1].failed == 1
    assert reports[0].left_s is not None
    assert reports[0].left_s > 0
    assert reports[-1].left_s == 0


def test_each_clip_that_is_done_is_in_the_log(
    scenes: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages: list[str] = []
    # Its own handler: a command that ran before in this process has set up the logger.
    handler = logging.Handler()
    monkeypatch.setattr(handler, "emit", lambda record: messages.append(record.getMessage()))
    logger = logging.getLogger("diethrow")
    monkeypatch.setattr(logger, "handlers", [handler])
    level = logger.level
    logger.setLevel(logging.INFO)
    try:
        with Processes(1) as processes:
            track(scenes[:2], tmp_path / "out", processes)
    finally:
        logger.setLevel(level)
    failed, done = sorted(messages)
    assert done.startswith("whole: tracked, ")
    assert failed.startswith("broken: failed: ")
    assert "clip.path" in failed


def test_folders_are_named_after_scenes_and_never_the_same(tmp_path: Path) -> None:
    root = tmp_path / "lab"
    scenes = [
        root / "day1/cube/scene.toml",
        root / "day2/cube/scene.toml",
        root / "ball/scene.toml",
        root / "ball/b.toml",
    ]
    names = [task.folder.name for task in tasks_of([*scenes, scenes[0]], tmp_path)]
    assert names == ["day1_cube", "day2_cube", "ball", "b"]


def test_a_batch_replaces_no_folder_that_is_not_its_own(scenes: list[Path], tmp_path: Path) -> None:
    mine = tmp_path / "out" / "whole" / "mine.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    (failure,) = track(scenes[:1], tmp_path / "out").failures
    assert failure.kind == "output"
    assert mine.read_text() == "mine"
    with pytest.raises(OutputExistsError):
        track(scenes[:1], mine)
    with pytest.raises(ValueError, match="no scenes"):
        track([], tmp_path / "out")


def test_two_batches_on_one_folder_exclude_each_other(
    scenes: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diethrow.files.outputs, "LOCK_TIMEOUT_S", 0.0)
    with locked(tmp_path / "out"), pytest.raises(OutputBusyError, match="another run is writing"):
        track(scenes, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_the_command_lists_failures_and_ends_with_status_1(scenes: list[Path], done: Path, tmp_path: Path) -> None:
    shutil.copytree(done, tmp_path / "out")
    words = ["batch", *map(str, scenes), "--out", str(tmp_path / "out"), "--only-track", "--quality", "fast"]
    result = CliRunner().invoke(app, [*words, "--workers", "1"])
    assert result.exit_code == 1
    assert "2 of 3 clips finished" in result.stdout
    assert f"failed: {scenes[1]}: clip.path = clip.cihx: clip.mraw: 100 bytes" in result.stderr
    words.remove(str(scenes[1]))
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0
    assert "2 of 2 clips finished, 2 of them earlier" in result.stdout


# --- processes ---


def test_the_death_of_a_process_fails_only_its_own_call() -> None:
    with Processes(2) as processes:
        other = processes.submit(time.sleep, 0.5)
        # The call kills its own process: which of the two executes it depends on how fast they start.
        killed = processes.submit(signal.raise_signal, signal.SIGKILL)
        with pytest.raises(WorkerLostError, match="SIGKILL"):
            killed.result(timeout=60)
        assert other.result(timeout=60) is None
        assert all(call.result(timeout=60) for call in [processes.submit(os.getpid) for _ in range(4)])


def test_a_new_process_replaces_a_dead_one() -> None:
    with Processes(1) as processes:
        pid = processes.submit(os.getpid).result()
        with pytest.raises(WorkerLostError, match="SIGKILL"):
            processes.submit(signal.raise_signal, signal.SIGKILL).result(timeout=60)
        assert processes.submit(os.getpid).result(timeout=60) != pid


def test_a_failing_call_raises_its_error_and_the_process_survives() -> None:
    with Processes(1) as processes:
        pid = processes.submit(os.getpid).result()
        with pytest.raises(ZeroDivisionError):
            processes.submit(divmod, 1, 0).result()
        assert processes.submit(os.getpid).result() == pid


def stopped_at_work(pids: list[int]) -> None:
    """Ctrl-C while a worker sleeps."""
    with Processes(1) as processes:
        pids.append(processes.submit(os.getpid).result())
        processes.submit(time.sleep, 60)
        raise KeyboardInterrupt


def test_an_exception_in_the_block_ends_running_workers() -> None:
    begun, pids = time.monotonic(), []  # type: ignore[var-annotated]
    with pytest.raises(KeyboardInterrupt):
        stopped_at_work(pids)
    assert time.monotonic() - begun < 20
    with pytest.raises(ProcessLookupError):
        os.kill(pids[0], 0)


PARENT = """
import os, sys, time
from diethrow.executors import Processes
if __name__ == "__main__":
    with Processes(1) as processes:
        print(processes.submit(os.getpid).result(), flush=True)
        processes.submit(time.sleep, 60).result()
"""


def test_workers_die_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        parent.kill()
        parent.stdout.close()
    for _ in range(200):
        if not Path(f"/proc/{pid}").exists() or b"Z" in Path(f"/proc/{pid}/stat").read_bytes().split()[2:3]:
            return
        time.sleep(0.05)
    pytest.fail("the worker lives on")


# --- kill -9 ---


def test_kills_affect_only_the_clips_being_analysed(scenes: list[Path], done: Path, tmp_path: Path) -> None:
    """Two kills; `benchmarks/kills.py` makes two hundred."""
    out = tmp_path / "out"
    good = [scenes[0], scenes[2]]
    words = [sys.executable, "-m", "diethrow", "batch", *map(str, good), "--out", str(out)]
    words += ["--only-track", "--quality", "fast", "--workers", "1"]
    rng = np.random.default_rng(7)
    stamps: dict[str, int] = {}
    for delay_s in rng.uniform(1.0, 6.0, 2):
        with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            time.sleep(delay_s)
            process.kill()
        for folder in (out / name for name in ("whole", "part") if (out / name).exists()):
            for file in (done / folder.name).glob("*.csv"):
                assert (folder / file.name).read_bytes() == file.read_bytes()
            assert stamps.setdefault(folder.name, folder.stat().st_ino) == folder.stat().st_ino
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    assert sorted(path.name for path in out.iterdir()) == ["failures.csv", "part", "results.csv", "whole"]
    for name, inode in stamps.items():
        assert (out / name).stat().st_ino == inode  # what was finished was not done again
    wanted = {name: content for name, content in numbers_in(done).items() if name != "results.csv"}
    assert {name: content for name, content in numbers_in(out).items() if name != "results.csv"} == wanted
