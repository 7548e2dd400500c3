"""Fixtures of every test, and options of the tests at the limits.

`pytest tests/extremes --slow --extremes-page docs/extremes.md` runs each stage at its limits and writes what was expected
and what happened; without `--slow`, tests that take longer than a few seconds are skipped.
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
def compilation_is_not_announced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which test first compiles a kernel is chance, and many tests count the lines of messages."""
    monkeypatch.setattr("diethrow.cli.compiling.announced", lambda say: nullcontext())
    monkeypatch.setattr("diethrow.cli.compiling.shared_compilation", lambda run, report: nullcontext())
    monkeypatch.setattr("diethrow.cli.compiling.is_compiled", lambda: True)


@pytest.fixture(scope="session", autouse=True)
def linear_algebra_on_one_thread() -> Iterator[None]:
    """As in every command: on a busy machine two threads that wait for each other take several times longer than one."""
    with one_thread():
        yield


@pytest.fixture
def happened(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Records what happened in a test at a limit; the test's docstring states what was expected."""

    def note(what: str) -> None:
        request.node.user_properties.append(("happened", what))

    return note


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
            properties = {"stage": item.module.__doc__, "expected": item.function.__doc__}
            item.user_properties += [(name, inspect.cleandoc(text or "")) for name, text in properties.items()]
            item.user_properties.append(("slow", slow))
        if slow and not config.getoption("--slow"):
            item.add_marker(pytest.mark.skip(reason="slow: give --slow"))
