"""Where compiled kernels are kept, and when they are compiled again.

numba keeps a compiled kernel beside its file and compiles it again when that file changes. It misses a change of a kernel or a
constant that the file imports, and would use the old machine code. Here the key of an entry is a digest of the sources: of the
kernel's file, of this package or not, and of all files of this package that its imports lead to. A change compiles what depends
on it, and only that. A copy of the folder, or another time stamp, compiles nothing.

numba's cache asks a *locator* for the folder and for a stamp of the source, and discards an entry whose stamp differs. These
classes are not part of numba's documented interface. The tests therefore also run on the lowest version of numba that the package
admits.

Two processes may compile versions of one kernel at the same time. numba numbers the files of versions, so that both would write
to the same file. Here a file's name is a digest of what it is for.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

from .kernel_library import MissingCodeError, from_cache, note_shared
from .source_digest import source_digest


class _KeyedOnSources:
    """A locator whose stamp is the digest of the sources."""

    _py_file: str

    def get_source_stamp(self) -> str:
        return source_digest(Path(self._py_file))


class _KernelCacheImpl(CompileResultCacheImpl):
    """numba's cache of compiled functions, in numba's folders."""

    _locator_classes = tuple(
        type(locator.__name__, (_KeyedOnSources, locator), {}) for locator in CompileResultCacheImpl._locator_classes
    )

    def reduce(self, result: Any) -> Any:
        """What the cache keeps of a compilation."""
        note_shared(result)
        return super().reduce(result)

    def rebuild(self, target: Any, kept: Any) -> Any:
        """The compilation's result."""
        return from_cache(target, super().rebuild, kept)


class _Index(IndexDataCacheFile):
    """The files of one kernel: one for each version, and the list of them.

    A version is found by the name of its file. The list serves to remove the files of older sources.
    """

    def has(self, key: Any) -> bool:
        """Whether there is a file for a version."""
        return Path(self._data_path(self._name_of(key))).exists()

    def load(self, key: Any) -> Any:
        """What was kept of a version, or None."""
        try:
            kept_key, kept = self._load_data(self._name_of(key))
        except OSError:
            return None
        return kept if kept_key == key else None

    def save(self, key: Any, kept: Any) -> None:
        """Keep a version."""
        name = self._name_of(key)
        self._save_data(name, (key, kept))
        versions = self._load_index()
        if not versions:
            self._remove_outdated()
        self._save_index({**versions, key: name})

    def _name_of(self, key: Any) -> str:
        return self._data_name_pattern.replace("{number:d}", _digest(self._source_stamp, self._version, *key))

    def _load_index(self) -> dict[Any, str]:
        """numba unpickles the argument types of an index before it compares the stamp. An index of older sources may name a type
        that no longer exists; it is outdated, so it counts as empty."""
        try:
            versions: dict[Any, str] = super()._load_index()
        except (AttributeError, ImportError):
            return {}
        return versions

    def _remove_outdated(self) -> None:
        """Remove the files of older sources; without the names of those whose types no longer exist."""
        with suppress(OSError, AttributeError, ImportError), open(self._index_path, "rb") as file:
            pickle.load(file)  # numba's version
            stamp, versions = pickle.load(file)
            if stamp != self._source_stamp:
                for name in versions.values():
                    Path(self._data_path(name)).unlink(missing_ok=True)


def _digest(*parts: Any) -> str:
    """A name for what is written alike in all processes: numba's types have names."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


class KernelCache(FunctionCache):
    """The cache of one kernel."""

    _impl_class: Any = _KernelCacheImpl

    def __init__(self, kernel: Callable[..., Any]) -> None:
        super().__init__(kernel)
        self._cache_file = _Index(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=self._impl.locator.get_source_stamp(),
        )

    def load_overload(self, signature: Any, target: Any) -> Any:
        """The compilation as it is kept, or None."""
        try:
            return super().load_overload(signature, target)
        except MissingCodeError:  # without a file that was there when this one was written
            return None

    def has(self, arguments: tuple[Any, ...], target: Any) -> bool:
        """Whether the version for these types of arguments is kept."""
        target.refresh()
        return self._cache_file.has(self._index_key(arguments, target.codegen()))
