"""`diethrow warm-up` compiles what every command needs, in the order that the kernels' calls allow, and says what it did."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event

import numba
import pytest
from typer.testing import CliRunner

from diethrow import kernel_list
from diethrow.cli.app import app
from diethrow.executors import Processes
from diethrow.kernel_list import Schedule, compile_listed, needed, version
from diethrow.model.kernel_versions import Version, decode, encode

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")

SAMPLES = Path(__file__).parents[2] / "data_samples"
CALLS = {0: [], 1: [0], 2: [0], 3: [1, 2], 4: []}
"""What each of five kernels calls."""


@pytest.fixture
def five(monkeypatch: pytest.MonkeyPatch) -> None:
    """A list of five kernels."""
    rows = [["module", f"kernel_{number}", [], calls, 0.4] for number, calls in CALLS.items()]
    listed = {"types": [], "versions": rows, "runs": {"analyze": [3], "odds": [4]}}
    monkeypatch.setattr(kernel_list, "_listed", lambda: listed)
    monkeypatch.setattr(kernel_list, "version", lambda number: Version("module", f"kernel_{number}", ()))


def schedule(last_first: bool = True) -> Schedule:
    return Schedule(range(5), last_first=last_first, report=lambda done, total: None)


def test_a_run_needs_what_its_kernels_call(five: None) -> None:
    assert needed("analyze") == [0, 1, 2, 3]
    assert needed("odds") == [4]
    assert needed() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("last_first", [True, False])
def test_a_kernel_is_compiled_after_all_that_it_calls(five: None, last_first: bool) -> None:
    plan, compiled = schedule(last_first), []
    while batch := plan.take():
        compiled += batch
        for number in batch:
            plan.end(Version("module", f"kernel_{number}", ()))
    assert sorted(compiled) == sorted(CALLS)
    assert all(compiled.index(callee) < compiled.index(caller) for caller, calls in CALLS.items() for callee in calls)
    assert plan.done == plan.total == 5


def test_a_helper_begins_at_the_end_and_leaves_what_the_run_compiles(five: None) -> None:
    plan = schedule()
    plan.begin(Version("module", "kernel_0", ()))
    assert plan.take() == [4]
    with ThreadPoolExecutor(1) as thread:
        waiting = thread.submit(plan.take)  # all else calls what the run is compiling
        assert not waiting.done()
        plan.end(Version("module", "kernel_0", ()))
        assert waiting.result() == [2, 1]
        plan.give_up()
        assert plan.take() == []


def test_a_process_that_dies_leaves_the_others_their_work(five: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_list, "compile_listed", _die)
    with Processes(1) as processes:
        plan = schedule()
        assert plan.serve(processes) == 2
        assert plan.left == [1, 2, 3]
        assert plan.take()  # nobody waits for the dead one's kernels


def _die(numbers: object) -> int:
    os._exit(1)


def test_stopped_processes_end_the_service(five: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_list, "compile_listed", _wait)
    with Processes(1) as processes, ThreadPoolExecutor(1) as thread:
        plan, begun = schedule(), Event()
        plan.take, take = lambda: (begun.set(), take())[1], plan.take  # type: ignore[method-assign]
        served = thread.submit(plan.serve, processes)
        begun.wait(10.0)
        plan.give_up()
        processes.stop()
        assert served.result(10.0) in (0, 2)  # 0 if it was stopped before it had work


def _wait(numbers: object) -> int:
    Event().wait(60.0)
    return 0


def test_a_type_is_read_as_it_was_written() -> None:
    int64, float64, boolean = numba.types.int64, numba.types.float64, numba.types.boolean
    kinds = (
        int64, boolean, numba.types.none, numba.types.Omitted(3), numba.types.Array(float64, 2, "C", readonly=True),
        numba.types.Array(numba.types.uint16, 3, "A"),
    )  # fmt: skip
    assert all(decode(json.loads(json.dumps(encode(kind))), ()) == kind for kind in kinds)
    with pytest.raises(TypeError, match="no type of an argument"):
        encode(numba.types.unicode_type)


def test_the_list_names_kernels_that_exist_with_their_number_of_arguments() -> None:
    """After a change of kernels: python benchmarks/kernel_list.py"""
    numbers = needed()
    outdated = [kernel_list._listed()["versions"][number][:2] for number in numbers if version(number) is None]
    assert not outdated
    for number in numbers:
        entry = version(number)
        assert len(entry.arguments) == entry.dispatcher.py_func.__code__.co_argcount, entry.kernel
    rows = kernel_list._listed()["versions"]
    assert all(callee < number for number, row in enumerate(rows) for callee in row[3])


def test_an_entry_that_no_longer_fits_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [["diethrow.model.engine.flight", "no_such_kernel", [], [], 0.1], ["no.such.module", "kernel", [], [], 0.1],
            ["diethrow.model.engine.flight", "advance", [0], [], 0.1]]  # fmt: skip
    listed = {"types": ["float64"], "versions": rows, "runs": {"analyze": [0, 1, 2]}}
    monkeypatch.setattr(kernel_list, "_listed", lambda: listed)
    for function in (kernel_list._types, version):
        monkeypatch.setattr(kernel_list, function.__name__, function.__wrapped__)
    assert kernel_list.missing() == [2]
    assert compile_listed([0, 1, 2]) == 1


FEW = """
import sys
from diethrow import kernel_list
from diethrow.cli import main
few = kernel_list.needed()[:3]
kernel_list._listed()["runs"] = {"few": few}
sys.argv = ["diethrow", "warm-up", "--processes", "1"]
main()
"""


def test_warm_up_says_what_it_did_and_when_there_is_nothing_to_do(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    run = [sys.executable, "-c", FEW]
    said = [
        subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout.strip()
        for _ in range(2)
    ]
    assert re.fullmatch(rf"[1-9]\d* kernels compiled in \d+ s by 1 process; the cache lies in {tmp_path}.*", said[0])
    assert re.fullmatch(rf"Nothing to do: all \d+ kernels are compiled; the cache lies in {tmp_path}.*", said[1])


def test_warm_up_refuses_to_work_where_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    done = CliRunner().invoke(app, ["warm-up"])
    assert done.exit_code == 1
    assert "NUMBA_DISABLE_JIT is set" in done.stderr


COUNTED = """
import sys
from numba.core import event
compiled = []
class Listener(event.Listener):
    def on_start(self, happening):
        kernel = happening.data["dispatcher"]
        if type(kernel._cache).__name__ == "KernelCache":
            compiled.append(f"{kernel.py_func.__module__}.{kernel.py_func.__name__}{happening.data['args']}")
    def on_end(self, happening):
        pass
event.register("numba:compile", Listener())
from diethrow.cli import main
sys.argv = ["diethrow", *sys.argv[1:]]
try:
    main()
finally:
    print("compiled:", len(compiled), *compiled, file=sys.stderr)
"""


@pytest.mark.slow
def test_after_warm_up_no_command_compiles_anything(tmp_path: Path) -> None:
    """In an empty cache. What fails here is added to the list by python benchmarks/kernel_list.py"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    scene, fit = SAMPLES / "cube_wood" / "scene.toml", tmp_path / "fit"
    track = tmp_path / "analysis" / "track_frames.csv"
    subprocess.run([sys.executable, "-m", "diethrow", "warm-up"], env=environment, check=True)
    for words in (
        ("analyze", scene, "--out", tmp_path / "analysis"),
        ("analyze", scene, "--quality", "fast", "--out", tmp_path / "fast"),
        ("fit", track, "--scene", scene, "--out", fit),
        ("predict", track, "--scene", scene, "--fit", fit / "fit.json", "--out", tmp_path / "predicted.csv"),
        ("throw", SAMPLES / "throws" / "tetrahedron_wood.toml", "--out", tmp_path / "throw"),
        ("odds", "--throws", "500", "--mu", "0.2", "--out", tmp_path / "odds"),
        ("basins", "--pixels", "10", "10", "--out", tmp_path / "basins"),
        ("lyapunov", "--orbits", "1", "--impacts", "300", "--out", tmp_path / "lyapunov"),
    ):
        run = [sys.executable, "-c", COUNTED, *map(str, words)]
        done = subprocess.run(run, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "compiled: 0\n" in done.stderr, (words[0], done.stderr)
