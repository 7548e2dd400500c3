"""A digest of all sources that a file depends on: what it imports from this package, to the last file.

Compiled kernels are kept under it. A change of a kernel, or of a constant that it imports, changes the digest of what depends on
it, and only that. A copy of the folder, or another time stamp, changes none.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

_IMPORT = re.compile(
    rf"^from (\.+|(?={__name__.partition('.')[0]}\b))([\w.]*) import (\([^)]*\)|[^\n#]*)", re.MULTILINE
)
"""An import from this package at the left margin, relative or by its name: the only ones that run when a module is imported."""


@cache
def source_digest(path: Path) -> str:
    """A digest of the file and of every file of the package that its imports lead to.

    Raises ImportError for an import that leads to no file.
    """
    digests = sorted({_file_digest(file) for file in _reached(path)})
    return hashlib.sha256("".join(digests).encode()).hexdigest()


@cache
def _file_digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _reached(path: Path) -> set[Path]:
    """The file, and all files that its imports lead to."""
    reached: set[Path] = set()
    ahead = [path]
    while ahead:
        file = ahead.pop()
        if file not in reached:
            reached.add(file)
            ahead += _imported(file)
    return reached


@cache
def _imported(path: Path) -> tuple[Path, ...]:
    """The files that define what a file imports; a name that an `__init__` re-exports leads to the file that defines it."""
    return tuple(_home(folder_or_module, name) for folder_or_module, name, _ in _imports(path))


@cache
def _imports(path: Path) -> tuple[tuple[Path, str, str], ...]:
    """Imports of a file from this package: where from (without suffix), the name there, and the name here."""
    found = []
    for dots, module, names in _IMPORT.findall(path.read_text(encoding="utf-8")):
        if dots:
            origin = path.parents[len(dots) - 1].joinpath(*filter(None, module.split(".")))
        else:
            origin = _folder_or_module(module)
        for each in _names(names):
            name, _, here = each.partition(" as ")
            found.append((origin, name.strip(), (here or name).strip()))
    return tuple(found)


def _folder_or_module(name: str) -> Path:
    """Folder, or file without suffix, of a module with a full name. Its folders need not lie in each other."""
    spec = find_spec(name)
    if spec is None or spec.origin is None:
        raise ImportError(f"{name}: no module of that name")
    file = Path(spec.origin)
    return file.parent if file.stem == "__init__" else file.with_suffix("")


def _names(text: str) -> Iterator[str]:
    """The parts between commas, without comments and parentheses."""
    bare = re.sub(r"#[^\n]*", "", text).strip("() \n")
    return (part.strip() for part in bare.split(",") if part.strip())


def _home(origin: Path, name: str) -> Path:
    """The file in which a name is defined that is imported from a module or a folder."""
    module = origin.with_suffix(".py")
    if module.is_file():
        return module
    init = origin / "__init__.py"
    for candidate in (origin / f"{name}.py", origin / name / "__init__.py"):
        if candidate.is_file():
            return candidate
    if not init.is_file():
        raise ImportError(f"{origin}: no module of that name, from which {name} is imported")
    for further, there, here in _imports(init):
        if here == name:
            return _home(further, there)
    return init
