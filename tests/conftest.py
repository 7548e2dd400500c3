"""What holds for every test, and what the tests at the limits say of themselves.

`pytest tests/extremes --slow --extremes-page docs/extremes.md` runs each stage at its limits
and writes what was expected and what happened; without `--slow`, what takes longer than a few seconds is left out.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest
from extremes_page import PageOfExtremes

from diethrow.executors import one_thread


@pytest.fixture(autouse=True)
def kernels_are_compiled_in_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which test meets a cold cache is chance, and many count the lines of what is said."""
    monkeypatch.setattr("diethrow.cli.compiling.announced", lambda say: nullcontext())
    monkeypatch.setattr("diethrow.cli.compiling.model_ahead", nullcontext)
    monkeypatch.setattr("diethrow.cli.compiling.is_compiled", lambda: True)


@pytest.fixture(scope="session", autouse=True)
def linear_algebra_on_one_thread() -> Iterator[None]:
    """As every command has it: two threads that wait for each other take longer than one, several times on a busy machine."""
    with one_thread():
        yield


@pytest.fixture
def happened(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Takes down, in words, what happened in a test at a limit; the test's docstring says what was expected."""

    def told(what: str) -> None:
        request.node.user_properties.append(("happened", what))

    return told


def pytest_addoption(parser: pytest.Parser) -> None:
    """The options of the tests at the limits."""
    group = parser.getgroup("extremes")
    group.addoption("--slow", action="store_true", help="run what takes longer than a few seconds, too")
    group.addoption("--extremes-page", type=Path, metavar="FILE", help="write what happened at the limits to a page")


def pytest_configure(config: pytest.Config) -> None:
    """With several workers, the one page is the controller's."""
    config.addinivalue_line("markers", "slow: takes longer than a few seconds; runs with --slow alone")
    path = config.getoption("--extremes-page")
    if path is not None and not hasattr(config, "workerinput"):
        config.pluginmanager.register(PageOfExtremes(path, config.rootpath))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Reports carry what the page needs, from whichever process they come."""
    for item in items:
        if not isinstance(item, pytest.Function):
            continue
        slow = item.get_closest_marker("slow") is not None
        if "happened" in item.fixturenames:
            told = {"stage": item.module.__doc__, "expected": item.function.__doc__}
            item.user_properties += [(name, inspect.cleandoc(text or "")) for name, text in told.items()]
            item.user_properties.append(("slow", slow))
        if slow and not config.getoption("--slow"):
            item.add_marker(pytest.mark.skip(reason="slow: give --slow"))
