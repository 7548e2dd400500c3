"""The first run announces the compilation of kernels and shares it with a second process."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from multiprocessing import active_children
from pathlib import Path

import numba
import pytest
from numba import njit
from typer.testing import CliRunner

from diethrow.cli import compiling
from diethrow.cli.app import app
from diethrow.cli.compiling import SENTENCE, announced, compile_model, model_ahead
from diethrow.commands.clip.batch import Batch
from diethrow.model import engine
from diethrow.model.engine import derivatives

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


@pytest.mark.parametrize("exception", [False, True])
def test_the_second_process_begins_with_the_first_compilation_and_ends_with_the_block(
    fresh: Callable[[float], float], exception: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiling, "compile_model", partial(time.sleep, 60))
    monkeypatch.setattr(compiling, "cores", lambda: 2)
    before, begun, during = set(active_children()), time.monotonic(), set()

    def first_run() -> None:
        with model_ahead():
            assert set(active_children()) == before
            fresh(1.0)
            while not during:  # a thread starts it
                during.update(set(active_children()) - before)
                time.sleep(0.01)
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


def test_on_one_core_no_second_process_compiles(
    fresh: Callable[[float], float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiling, "cores", lambda: 1)
    monkeypatch.setattr(compiling, "Processes", None)  # would raise if called
    with model_ahead():
        fresh(1.0)


def test_the_model_is_compiled_in_every_way_that_a_fit_needs() -> None:
    """The laws that fits use: smooth impacts, friction, and air drag."""
    compile_model()
    law = engine.Setup._fields.index("law")
    kinds = {(each[0][law].instance_class, each[1].instance_class) for each in derivatives.run_tangent.signatures}
    smooth, rough = engine.SmoothLaw, engine.RoughLaw
    assert kinds >= {(smooth, engine.Vacuum), (rough, engine.Vacuum), (smooth, engine.Air)}
    assert any(each[0][law].instance_class is smooth for each in engine.run_throw.signatures)


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
