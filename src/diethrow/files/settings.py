"""Reads TOML files into checked tables; every mistake becomes an error of one sentence.

A pydantic model describes a settings file. The `description` of a field says what it accepts, and is the second half of the error
for a wrong value, so rule and message agree.
"""

from __future__ import annotations

import difflib
import json
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from ..model.errors import InputError

Array = NDArray[np.float64]
AnyTable = TypeVar("AnyTable", bound="TomlTable")

MAX_FILE_BYTES = 2**20
"""A hundred times a long scene; a larger file is something else."""
MAX_VALUE_CHARACTERS = 90
"""Longest part of a value that an error repeats."""
MIN_SIMILARITY = 0.6
"""Of an unknown key to a known one (`difflib`) for which the error suggests it."""


class SceneError(InputError):
    """A scene or throw file that cannot be used; the text names file, key and value, and what is accepted."""


class TomlTable(BaseModel):
    """One TOML table. Strict: text is no number, and a number is no truth value."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, populate_by_name=True)


def _shaped(*shape: int) -> Callable[[list[Any]], list[Any]]:
    def check(value: list[Any]) -> list[Any]:
        lengths = [value, *(value if len(shape) == 2 else [])]
        wanted = [shape[0], *([shape[1]] * len(value) if len(shape) == 2 else [])]
        if [len(part) for part in lengths] != wanted:
            raise InputError("wrong shape")
        return value

    return check


Vector2i = Annotated[list[int], AfterValidator(_shaped(2))]
Vector3 = Annotated[list[float], AfterValidator(_shaped(3))]
Vector4 = Annotated[list[float], AfterValidator(_shaped(4))]
Vector5 = Annotated[list[float], AfterValidator(_shaped(5))]
Matrix3 = Annotated[list[list[float]], AfterValidator(_shaped(3, 3))]


def _positive(value: float) -> float:
    if not value > 0:
        raise InputError("not above 0")
    return value


def not_negative(value: float) -> float:
    if value < 0:
        raise InputError("below 0")
    return value


Positive = Annotated[float, AfterValidator(_positive)]
NotNegative = Annotated[float, AfterValidator(not_negative)]
PositiveInt = Annotated[int, AfterValidator(_positive)]
NotNegativeInt = Annotated[int, AfterValidator(not_negative)]


def read_toml(path: Path) -> tuple[dict[str, Any], str]:
    """The tables of a TOML file and its text. Raises SceneError where it is absent, not text, or not TOML."""
    if not path.exists():
        raise SceneError(f"{path}: there is no such file; wanted a TOML file")
    if not path.is_file():
        raise SceneError(f"{path}: this is a folder; wanted a TOML file, for example {path / 'scene.toml'}")
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise SceneError(f"{path}: {path.stat().st_size} bytes; wanted a TOML file of {MAX_FILE_BYTES} at most")
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: byte {error.start} is not UTF-8; wanted a TOML file in UTF-8") from error
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror}); wanted a TOML file") from error
    return tables_of(text, path), text


def tables_of(text: str, path: Path) -> dict[str, Any]:
    """The tables of a TOML text, which was read from a file. Raises SceneError where it is not TOML."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # besides TOMLDecodeError: numbers too long, tables too deep
        raise SceneError(f"{path}: not valid TOML, {_lower_first(str(error))}") from error


def validate(model: type[AnyTable], data: dict[str, Any], path: Path) -> AnyTable:
    """`data` as `model`. Raises SceneError with the first mistake and the number of further ones."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        # An unknown key explains a missing one (edge_mm for edge_m), so it comes first.
        first = min(problems, key=lambda problem: problem["type"] != "extra_forbidden")
        more = f" ({len(problems) - 1} more after this one)" if len(problems) > 1 else ""
        raise SceneError(f"{path}: {_sentence(model, data, first)}{more}") from error


def refuse(path: Path, key: str, value: Any, wanted: str) -> SceneError:
    """The error for a well-formed but impossible value; `key` is dotted, as in `camera.rotation`."""
    return SceneError(f"{path}: {key} = {shown(value)}: {wanted}")


def shown(value: Any) -> str:
    """A value in the form in which an error repeats it: on one line and short."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):
        text = str(value)
    return text if len(text) <= MAX_VALUE_CHARACTERS else text[: MAX_VALUE_CHARACTERS - 3] + "..."


def _sentence(model: type[BaseModel], data: dict[str, Any], problem: Any) -> str:
    loc, kind = tuple(problem["loc"]), problem["type"]
    owner, field_loc = _owner(model, loc)
    key = _spelled(field_loc, data)
    if kind == "extra_forbidden":
        return f"{key} = {shown(problem['input'])}: there is no such key; {_nearest(str(loc[-1]), model, owner)}"
    wanted = _accepted(owner, str(field_loc[-1]))
    if kind == "missing":
        return f"{key} is missing; wanted {wanted}"
    return f"{key} = {shown(_at(data, field_loc))}: wanted {wanted}"


def _owner(model: type[BaseModel], loc: tuple[Any, ...]) -> tuple[type[BaseModel], tuple[Any, ...]]:
    """The table that a location lies in, and the location cut off at the table's key: no index into a matrix."""
    owner = model
    for depth, part in enumerate(loc):
        if isinstance(part, int):
            continue
        inner = _table_of(owner, part)
        if inner is None or depth == len(loc) - 1 or (depth == len(loc) - 2 and isinstance(loc[-1], int)):
            return owner, loc[: depth + 1]
        owner = inner
    return owner, loc


def _table_of(model: type[BaseModel], key: str) -> type[BaseModel] | None:
    for name, field in model.model_fields.items():
        if key in (name, field.alias):
            return _first_model(field.annotation)
    return None


def _first_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := _first_model(part))), None)


def _accepted(owner: type[BaseModel], key: str) -> str:
    for name, field in owner.model_fields.items():
        if key in (name, field.alias) and field.description:
            return field.description
    return "a known key"


def _nearest(key: str, model: type[BaseModel], owner: type[BaseModel]) -> str:
    """A suggestion for an unknown key: a similar key of its table, or the same key of another table."""
    known = _keys(owner)
    close = difflib.get_close_matches(key, known, n=1, cutoff=MIN_SIMILARITY)
    if close:
        return f"did you mean {close[0]}?"
    for name in _keys(model):
        inner = _table_of(model, name)
        if inner is not None and inner is not owner and key in _keys(inner):
            return f"it belongs in [{name}]"
    return f"known here are {', '.join(known)}"


def _keys(model: type[BaseModel]) -> list[str]:
    return [field.alias or name for name, field in model.model_fields.items()]


def _spelled(loc: tuple[Any, ...], data: dict[str, Any]) -> str:
    """`camera.rotation`, or `camera[2].rotation` (counted from 1) where there are several cameras."""
    words: list[str] = []
    for depth, part in enumerate(loc):
        if not isinstance(part, int):
            words.append(str(part))
        elif len(_at(data, loc[:depth])) > 1:
            words[-1] += f"[{part + 1}]"
    return ".".join(words)


def _at(data: Any, loc: tuple[Any, ...]) -> Any:
    for part in loc:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def _lower_first(text: str) -> str:
    return text[:1].lower() + text[1:]


def unit_guess(value: float, factors: tuple[float, ...], fits: Callable[[float], bool]) -> str:
    """`; did you mean 0.016?` where one of the factors of units makes the value possible, else nothing."""
    guess = next((value * factor for factor in factors if fits(value * factor)), None)
    return "" if guess is None else f"; did you mean {guess:.6g}?"


@dataclass(frozen=True)
class FilesBeside:
    """The files that a settings file names."""

    settings_path: Path
    allow_outside: bool
    may_be_gone: bool = False
    """Whether files are named that need not be there any more."""

    def existing(self, text: str | None, key: str, wanted: str) -> Path | None:
        """The file that `text` names, relative to it; a pattern such as `frames/*.png` must match something."""
        if text is None:
            return None
        found = self.settings_path.parent / text
        if not self.allow_outside and self._leaves(found):
            reason = (
                f"the path leads out of the scene's folder; wanted {wanted} and inside its folder, or --allow-outside"
            )
            raise refuse(self.settings_path, key, text, reason)
        try:
            there = found.exists()
        except OSError as error:
            raise refuse(self.settings_path, key, text, f"{error.strerror}; wanted {wanted}") from error
        if there or self.may_be_gone:
            return found
        if any(letter in found.name for letter in "*?[") and any(found.parent.glob(found.name)):
            return found
        raise refuse(self.settings_path, key, text, f"{found} does not exist; wanted {wanted}")

    def _leaves(self, found: Path) -> bool:
        """Whether the path itself leads out of the folder. A link inside the folder is followed: its owner made it, for
        example to films on another disk."""
        folder = self.settings_path.parent
        if ".." in found.parts:  # a link before `..` decides where it leads
            return not found.resolve().is_relative_to(folder.resolve())
        inside = found.absolute()
        return not (inside.is_relative_to(folder.absolute()) or inside.is_relative_to(folder.resolve()))
