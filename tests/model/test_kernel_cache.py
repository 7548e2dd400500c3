"""A kernel is compiled again when a source that it depends on has changed, and only then."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import diethrow.model
from diethrow.model.source_digest import source_digest

MODEL = Path(diethrow.model.__file__).parent

FALL = """
import numpy as np
from diethrow.model import engine
state = np.zeros(13)
state[3] = 1.0
state[12] = 3.0
engine.advance(state, engine.spin_rate(state), 1.0, engine.LEVEL)
print(state[2], state[6], len(engine.advance._cache_hits), sum(engine.advance.stats.cache_misses.values()))
"""
"""Height [m] after a second of fall, sine of half the turn, and how often `advance` was compiled."""


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the package's model, to be edited."""
    package = tmp_path / "diethrow"
    package.mkdir()
    (package / "__init__.py").touch()
    shutil.copytree(MODEL, package / "model", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def fall(folder: Path) -> tuple[float, float, int]:
    """Height, sine of half the turn, compilations."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    result = subprocess.run(
        [sys.executable, "-c", FALL],
        env={**environment, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
    )
    height, sine, _, misses = result.stdout.split()
    return float(height), float(sine), int(misses)


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_a_kernel_is_compiled_again_after_an_edit_of_a_constant_and_only_then(copy: Path) -> None:
    model = copy / "diethrow" / "model"
    height, sine, compiled = fall(copy)
    assert compiled == 1
    assert height == pytest.approx(-9.81 / 2)
    assert fall(copy) == (height, sine, 0)

    edit(model / "world.py", "GRAVITY_M_S2 = 9.81", "GRAVITY_M_S2 = 1.62")
    assert fall(copy) == (pytest.approx(-1.62 / 2), sine, 1)

    edit(model / "ensembles" / "basins.py", '"""', '"""No kernel depends on this. ')
    assert fall(copy)[2] == 0


@pytest.mark.parametrize("where", ["diethrow.model.engine", "outside"])
def test_a_kernel_is_compiled_again_after_an_edit_of_a_callee_in_another_file(copy: Path, where: str) -> None:
    """Whether it belongs to the package or to who uses it."""
    (copy / "outside").mkdir()
    caller, callee = (
        copy.joinpath(*where.split(".")) / "caller.py",
        copy / "diethrow" / "model" / "engine" / "callee.py",
    )
    origin = ".callee" if "engine" in where else "diethrow.model.engine.callee"
    callee.write_text("from ..compiled import compiled\n\n\n@compiled\ndef callee(x):\n    return 2.0 * x\n")
    caller.write_text(
        f"from diethrow.model.compiled import compiled\nfrom {origin} import callee\n\n\n"
        "@compiled\ndef caller(x):\n    return callee(x) + 1.0\n"
    )
    run = [sys.executable, "-c", f"from {where}.caller import caller; print(caller(1.0))"]
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    first = subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout
    edit(callee, "2.0", "5.0")
    second = subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout
    assert (float(first), float(second)) == (3.0, 6.0)


def test_an_index_with_a_removed_argument_type_is_outdated(copy: Path) -> None:
    """The first run after an update once stopped with an AttributeError from numba's unpickling."""
    package = copy / "diethrow" / "model"
    kernel = package / "engine" / "doubling.py"
    text = (
        "from typing import NamedTuple\nfrom ..compiled import compiled\n\n\nclass Old(NamedTuple):\n    x: float\n\n\n"
        "@compiled\ndef doubled(value):\n    return 2.0 * value.x\n\n\nprint(doubled(Old(1.5)))\n"
    )
    for name in ("Old", "New"):
        kernel.write_text(text.replace("Old", name))
        run = [sys.executable, "-c", "import diethrow.model.engine.doubling"]
        environment = {**os.environ, "PYTHONPATH": str(copy)}
        assert float(subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout) == 3.0


def test_the_digest_depends_on_contents_and_not_on_places_or_times(copy: Path) -> None:
    for name in ("engine/event_loop.py", "ensembles/landings.py", "throw/simulate.py"):
        assert source_digest(MODEL / name) == source_digest(copy / "diethrow" / "model" / name)


def test_an_import_of_a_missing_module_raises_an_error(tmp_path: Path) -> None:
    file = tmp_path / "package" / "kernel.py"
    file.parent.mkdir()
    file.write_text("from .missing import nothing\n")
    with pytest.raises(ImportError, match="missing"):
        source_digest(file)


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    """A kernel `outer` that copies `middle`, which calls the shared `core`; `other` copies `middle` as well."""
    folder = tmp_path / "chain"
    folder.mkdir()
    (folder / "kernels.py").write_text(
        "from diethrow.model.compiled import compiled, inner\n\n\n"
        "@inner(shared=True)\ndef core(x):\n    return 2.0 * x\n\n\n"
        "@inner\ndef middle(x):\n    return core(x) + 1.0\n\n\n"
        "@compiled\ndef outer(x):\n    return middle(x)\n\n\n"
        "@compiled\ndef other(x):\n    return 10.0 * middle(x)\n"
    )
    return tmp_path


def call(folder: Path, kernel: str) -> tuple[float, list[str]]:
    """The value of a kernel at 3 in a new process, and the kernels that were compiled for it."""
    program = (
        f"from chain import kernels; value = kernels.{kernel}(3.0); names = 'core', 'middle', 'outer', 'other';"
        "print(value, *[name for name in names if sum(getattr(kernels, name).stats.cache_misses.values())])"
    )
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache")}
    run = [sys.executable, "-c", program]
    value, *names = subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout.split()
    return float(value), names


def test_callers_in_the_cache_load_the_shared_kernel_that_they_call(chain: Path) -> None:
    """Also where a kernel was compiled with a copy from the cache: such a caller once ended the process."""
    assert call(chain, "outer") == (7.0, ["core", "middle", "outer"])
    assert call(chain, "other") == (70.0, ["other"])
    assert call(chain, "other") == (70.0, [])


def test_a_shared_kernel_that_changed_or_is_gone_is_compiled_again_and_no_file_is_left_behind(chain: Path) -> None:
    call(chain, "outer")
    files = sorted(file.name for file in (chain / "cache").rglob("*.nb?"))
    for file in (chain / "cache").rglob("kernels.core-*.nbc"):
        file.unlink()
    assert call(chain, "outer") == (7.0, ["core"])
    edit(chain / "chain" / "kernels.py", "2.0 * x", "5.0 * x")
    assert call(chain, "outer") == (16.0, ["core", "middle", "outer"])
    after = sorted(file.name for file in (chain / "cache").rglob("*.nb?"))
    assert len(files) == len(after) == 6
    assert len(set(files) & set(after)) == 3  # the indices


def test_a_literal_between_kernels_compiles_nothing_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "literals.py").write_text(
        "from diethrow.model.compiled import compiled, inner\n\n\n"
        "@inner\ndef scaled(x, n):\n    return n * x\n\n\n"
        "@compiled\ndef both(x, n):\n    return scaled(x, 3) + scaled(x, n)\n"
    )
    program = "from literals import both, scaled; print(both(1.0, 2), len(scaled.signatures))"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path)}
    run = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["5.0", "1"]
