"""CSV tables and JSON files: read and written, and checked cell by cell.

Numbers are written with all their digits, so a number that is read back is the number that was written, bit by bit. An unknown
number is an empty cell in a table, `null` in JSON and NaN in an array. Every error names the file, and of a table the column, the
value and the row, counted from 1 below the header.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.errors import InputError

MAX_FILE_BYTES = 2**27
"""A table of a track of 300 000 frames. A larger file is refused before it fills the memory."""
MAX_CELL_CHARACTERS = 1000
"""No number needs more; a file with longer cells is no table of numbers."""
MAX_NUMBER = 1e100
"""In SI units; its square is still a number."""
MAX_WHOLE = 2**53
"""Largest whole number up to which a double holds all of them."""
MAX_QUOTED_CHARACTERS = 60
"""Of a wrong cell, in an error."""

Row = Mapping[str, str]


class Table:
    """A CSV table in memory: cells by row and column, and the errors that name them."""

    def __init__(self, path: Path, rows: list[dict[str, str]]) -> None:
        self.path, self.rows = path, rows

    def __len__(self) -> int:
        return len(self.rows)

    def is_empty(self, row: int, columns: Iterable[str]) -> bool:
        """Whether any of these cells is empty."""
        return any(self.rows[row][column] == "" for column in columns)

    def text(self, row: int, column: str, allowed: Sequence[str]) -> str:
        """A cell that holds one of some words."""
        value = self.rows[row][column]
        if value not in allowed:
            raise self.error(row, column, f"one of {', '.join(allowed)}")
        return value

    def number(self, row: int, column: str, *, empty: float | None = None) -> float:
        """A finite number; `empty`, where that is given, for an empty cell."""
        cell = self.rows[row][column]
        if cell == "" and empty is not None:
            return empty
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        if not abs(value) <= MAX_NUMBER:
            raise self.error(row, column, "a finite number")
        return value

    def whole(self, row: int, column: str) -> int:
        """A whole number."""
        value = self.number(row, column)
        if value != int(value) or abs(value) > MAX_WHOLE:
            raise self.error(row, column, "a whole number")
        return int(value)

    def numbers(self, columns: Sequence[str], use: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
        """(rows, columns) of numbers; NaN in the rows that are not in `use` (rows,)."""
        values = np.full((len(self), len(columns)), np.nan)
        for k in range(len(self)) if use is None else np.flatnonzero(use).tolist():
            values[k] = [self.number(k, column) for column in columns]
        return values

    def error(self, row: int, column: str, wanted: str) -> InputError:
        """The error for a cell."""
        value = self.rows[row][column][:MAX_QUOTED_CHARACTERS]
        return InputError(f"{self.path}: {column} = {value!r} in row {row + 1}; wanted {wanted}")


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    """A CSV table in UTF-8, with a header of column names."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([_cell(value) for value in row] for row in rows)


def read_table(path: Path, required: Sequence[str], *, allowed: Sequence[str] | None = None) -> Table:
    """A CSV table that has at least the columns `required`; other `allowed` columns have empty cells where they are missing.

    Raises FileNotFoundError, and ValueError for what is not such a table.
    """
    try:
        _check_size(path)
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, restval="")
            names = tuple(reader.fieldnames or ())
            missing = [name for name in required if name not in names]
            if missing:
                raise InputError(f"{path}: column {missing[0]} is missing; wanted {','.join(required)}")
            empty = dict.fromkeys(allowed or required, "")
            rows = [{**empty, **{name: (row[name] or "").strip() for name in names}} for row in reader]
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: there is no such file; wanted a CSV table") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: not a CSV table in UTF-8 ({error})") from error
    for k, row in enumerate(rows):
        for name, cell in row.items():
            if len(cell) > MAX_CELL_CHARACTERS:
                raise InputError(
                    f"{path}: {name} has {len(cell)} characters in row {k + 1}; wanted {MAX_CELL_CHARACTERS} at most"
                )
    return Table(path, rows)


def write_json(path: Path, data: Any) -> None:
    """JSON in UTF-8 with an indent of two spaces; arrays become lists, and what is not finite becomes null."""
    text = json.dumps(plain(data), indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """The content of a JSON file. Raises FileNotFoundError, and ValueError for what is not JSON."""
    try:
        _check_size(path)
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: there is no such file; wanted a JSON file") from error
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({error})") from error


def plain(data: Any) -> Any:
    """`data` as JSON can hold it: no arrays, no numpy scalars, no paths, no NaN."""
    if isinstance(data, Mapping):
        return {str(key): plain(value) for key, value in data.items()}
    if isinstance(data, np.ndarray):
        return plain(data.tolist())
    if isinstance(data, (list, tuple)):
        return [plain(value) for value in data]
    if isinstance(data, np.generic):
        return plain(data.item())
    if isinstance(data, float) and not math.isfinite(data):
        return None
    return str(data) if isinstance(data, Path) else data


def _cell(value: Any) -> str:
    """A number with all its digits; what is not finite is empty."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return repr(float(value)) if isinstance(value, float) else str(value)


def _check_size(path: Path) -> None:
    size = path.stat().st_size
    if size > MAX_FILE_BYTES:
        raise InputError(
            f"{path}: {size} bytes; wanted {MAX_FILE_BYTES} at most; give a table or a JSON file of a result"
        )
