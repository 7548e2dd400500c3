"""Laws of the distribution: every folder of the tree is a package of the wheel, and every file of it lies in the wheel."""

from __future__ import annotations

import importlib.metadata
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
SETUPTOOLS = PROJECT["tool"]["setuptools"]
DATA_FILES = {
    "diethrow/py.typed",
    "diethrow/kernels.json",
    "diethrow/replay/player/player.css",
    "diethrow/replay/player/player.js",
}
BUILD = "from setuptools import build_meta; build_meta.build_wheel('wheel')"


def files_of_packages() -> dict[str, Path]:
    """Every source file of the tree, by its path in an installed package."""
    return {
        "/".join((*package.split("."), *path.relative_to(ROOT / folder).parts)): path
        for package, folder in SETUPTOOLS["package-dir"].items()
        for path in (ROOT / folder).rglob("*.py")
    }


def test_the_list_of_packages_names_every_folder_of_the_tree() -> None:
    folders = {name.rpartition("/")[0].replace("/", ".") for name in files_of_packages()}
    assert sorted(SETUPTOOLS["packages"]) == sorted(folders)
    assert folders == {
        name.removesuffix("/__init__.py").replace("/", ".") for name in files_of_packages() if "__init__" in name
    }


def test_the_wheel_holds_every_file_of_the_tree(tmp_path: Path) -> None:
    wanted = int(re.findall(r"setuptools>=(\d+)", " ".join(PROJECT["build-system"]["requires"]))[0])
    try:
        found = importlib.metadata.version("setuptools")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("setuptools is not installed, so no wheel can be built here")
    if int(found.split(".")[0]) < wanted:
        pytest.skip(f"setuptools {found} is installed; the project is built with {wanted} or later")
    for name in ("pyproject.toml", "README.md", "LICENSE", *SETUPTOOLS["package-dir"].values()):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        if not (tmp_path / name).exists():
            copy(ROOT / name, tmp_path / name)
    subprocess.run([sys.executable, "-c", BUILD], cwd=tmp_path, check=True, capture_output=True)
    (wheel,) = (tmp_path / "wheel").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert held == files_of_packages().keys() | DATA_FILES
