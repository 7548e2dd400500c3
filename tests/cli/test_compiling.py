"""The first run announces the compilation of kernels and shares it with a second process."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children
from pathlib import Path

import numba
import pytest
from numba import njit
from typer.testing import CliRunner

from diethrow import kernel_list
from diethrow.cli import compiling
from diethrow.cli.app import app
from diethrow.cli.compiling import SENTENCE, announced, shared_compilation
from diethrow.cli.progress import progress_bars
from diethrow.commands.clip.batch import Batch
from diethrow.model.kernel_versions import Version

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


class _Kept:
    """A cache that is always empty."""

    def load_overload(self, *_: object) -> None:
        return None

    def save_overload(self, *_: object) -> None:
        pass


@pytest.fixture
def fresh() -> Callable[[float], float]:
    """A kernel of ours that no cache holds yet."""

    def twice(x: float) -> float:
        return 2.0 * x

    twice.__module__ = "diethrow.model.engine.flight"
    kernel = njit(twice)
    kernel._cache = _Kept()
    return kernel  # type: ignore[no-any-return]


def test_compilation_is_announced_once_and_only_for_cached_kernels(fresh: Callable[[float], float]) -> None:
    def thrice(x: float) -> float:
        return 3.0 * x

    thrice.__module__ = "diethrow.model.engine.flight"
    messages: list[str] = []
    with announced(messages.append):
        assert njit(thrice)(1.0) == 3.0  # compiled in every run: no word of it
        assert messages == []
        assert fresh(1.0) == 2.0
        assert fresh(1) == 2
    assert messages == [SENTENCE]


@pytest.fixture
def endless(monkeypatch: pytest.MonkeyPatch) -> None:
    """A list of two kernels that a helper compiles for a minute."""
    monkeypatch.setattr(compiling, "cores", lambda: 2)
    monkeypatch.setattr(kernel_list, "missing", lambda run: [0, 1])
    monkeypatch.setattr(kernel_list, "compile_listed", partial(time.sleep, 60))


def uncounted(done: int, total: int) -> None:
    pass


@pytest.mark.parametrize("exception", [False, True])
def test_the_second_process_begins_with_the_first_compilation_and_ends_with_the_block(
    fresh: Callable[[float], float], endless: None, exception: bool
) -> None:
    before, begun, during = set(active_children()), time.monotonic(), set()

    def first_run() -> None:
        with shared_compilation("analyze", uncounted):
            assert set(active_children()) == before
            fresh(1.0)
            during.update(set(active_children()) - before)
            if exception:
                raise KeyboardInterrupt

    if exception:
        with pytest.raises(KeyboardInterrupt):
            first_run()
    else:
        first_run()
    assert len(during) == 1
    assert not any(process.is_alive() for process in during)
    assert time.monotonic() - begun < 20


def test_a_helper_that_dies_does_not_disturb_the_run(
    fresh: Callable[[float], float], endless: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernel_list, "compile_listed", partial(os._exit, 1))
    with shared_compilation("analyze", uncounted):
        assert fresh(1.0) == 2.0
        assert fresh(1) == 2


def test_on_one_core_no_second_process_compiles(
    fresh: Callable[[float], float], endless: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiling, "cores", lambda: 1)
    monkeypatch.setattr(compiling, "Processes", None)  # would raise if called
    with shared_compilation("analyze", uncounted):
        fresh(1.0)


def test_what_the_run_compiles_is_counted(fresh: Callable[[float], float], monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = (numba.types.float64,)
    monkeypatch.setattr(compiling, "cores", lambda: 1)
    monkeypatch.setattr(kernel_list, "missing", lambda run: [0, 1])
    monkeypatch.setattr(kernel_list, "version", lambda number: (Version.of(fresh, arguments), None)[number])
    counts: list[tuple[int, int]] = []
    with shared_compilation("analyze", lambda *count: counts.append(count)):
        fresh(1.0)
    assert counts == [(0, 2), (1, 2)]


def test_the_count_is_announced_at_the_start_and_at_each_quarter(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where there is no terminal for a bar."""

    @contextmanager
    def compiled_in_steps(run: str, report: Callable[[int, int], None]) -> Iterator[None]:
        for done in range(9):
            report(done, 8)
        yield

    monkeypatch.setattr(compiling, "shared_compilation", compiled_in_steps)
    with progress_bars("analyze"):
        pass
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"diethrow: compiling the kernels, once per installation: {done} of 8" for done in (0, 2, 4, 6, 8)]


def test_an_empty_cache_is_detected(tmp_path: Path) -> None:
    program = "from diethrow.cli.compiling import is_compiled; print(is_compiled())"
    empty = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    printed = subprocess.run([sys.executable, "-c", program], env=empty, capture_output=True, text=True, check=True)
    assert printed.stdout.strip() == "False"


@pytest.mark.parametrize("cold", [True, False])
def test_a_batch_announces_compilation_once(cold: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "is_compiled", lambda: not cold)
    monkeypatch.setattr("diethrow.commands.clip.batch.run_batch", lambda *_, **__: Batch((), (), 0))
    message = CliRunner().invoke(app, ["batch", "a.toml", "b.toml", "--out", "out"]).stderr
    assert message.count(SENTENCE) == cold
