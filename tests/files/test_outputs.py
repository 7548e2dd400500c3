"""A folder of results appears complete or not at all."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from diethrow.files.outputs import OutputExistsError, whole_folder


def write(folder: Path, text: str, *, force: bool = False) -> None:
    with whole_folder(folder, force=force) as aside:
        (aside / "track.csv").write_text(text)


def interfere(folder: Path, act: Callable[[], None], *, force: bool = False) -> None:
    """Write a folder while something else happens."""
    with whole_folder(folder, force=force) as aside:
        (aside / "track.csv").write_text("half")
        act()


def fail(folder: Path, failure: type[BaseException], *, force: bool = False) -> None:
    """Write a folder and fail half-way."""

    def act() -> None:
        raise failure

    interfere(folder, act, force=force)


def test_a_folder_appears_only_when_it_is_complete(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    with whole_folder(out) as aside:
        (aside / "track.csv").write_text("new")
        assert not out.exists()
    assert (out / "track.csv").read_text() == "new"
    assert list(out.parent.iterdir()) == [out]


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt, SystemExit, OSError])
def test_a_run_that_fails_or_is_stopped_leaves_nothing(tmp_path: Path, failure: type[BaseException]) -> None:
    with pytest.raises(failure):
        fail(tmp_path / "out", failure)
    assert list(tmp_path.iterdir()) == []


def test_a_terminated_run_leaves_nothing(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt):
        interfere(tmp_path / "out", lambda: os.kill(os.getpid(), signal.SIGTERM))
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_folder_that_exists_is_kept_unless_forced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out, "old")
    (out / "extra.txt").write_text("of the old run")
    with pytest.raises(OutputExistsError, match="--force"):
        write(out, "new")
    assert (out / "track.csv").read_text() == "old"
    write(out, "new", force=True)
    assert [file.name for file in out.iterdir()] == ["track.csv"]
    assert (out / "track.csv").read_text() == "new"


def test_a_forced_run_that_fails_keeps_the_old_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out, "old")
    with pytest.raises(RuntimeError):
        fail(out, RuntimeError, force=True)
    assert (out / "track.csv").read_text() == "old"
    assert list(tmp_path.iterdir()) == [out]


def test_a_folder_made_by_somebody_else_meanwhile_is_kept(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(OutputExistsError):
        interfere(out, lambda: (out / "deeper").mkdir(parents=True))
    assert list(out.iterdir()) == [out / "deeper"]
    assert list(tmp_path.iterdir()) == [out]


def test_even_force_erases_no_input_no_file_and_no_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "clips"
    out.mkdir()
    (out / "scene.toml").write_text("")
    with (
        pytest.raises(OutputExistsError, match=r"scene\.toml"),
        whole_folder(out, force=True, inputs=[out / "scene.toml"]),
    ):
        pass
    with pytest.raises(OutputExistsError, match="not a folder"), whole_folder(out / "scene.toml", force=True):
        pass
    monkeypatch.chdir(out)
    with pytest.raises(OutputExistsError, match="must stay"), whole_folder(tmp_path, force=True):
        pass
    assert (out / "scene.toml").exists()


def test_an_ordinary_user_may_read_the_folder(tmp_path: Path) -> None:
    write(tmp_path / "out", "new")
    (tmp_path / "plain").mkdir()
    assert (tmp_path / "out").stat().st_mode == (tmp_path / "plain").stat().st_mode
