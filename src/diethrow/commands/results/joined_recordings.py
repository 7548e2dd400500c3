"""Recordings of several throws: joined in one recording, or copied to one folder with a table of one row per throw.

A throw is given by the folder that `analyze`, `fit` or `throw` wrote, or by its `replay.rrd`; a folder of such folders
gives all of them.
"""

from __future__ import annotations

import csv
import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...files.csv_and_json import read_json
from ...files.outputs import MIN_FREE_BYTES, check_free_space, whole_file, whole_folder
from ...files.provenance import Stopwatch, write_provenance
from ...model.errors import InputError
from ...replay.recording import Source, join_recordings, properties_of

RECORDING = "replay.rrd"
COLUMNS = ("chi", "chi_low", "chi_high", "bounces", "bounces_fitted", "residual_rms", "landed_face", "verdict")
"""Properties of a recording that the table shows."""
BOUNCE = "bounce"
"""Align the clocks of several throws at their first bounces."""
FRAME = "frame"
"""Align them at their frames 0."""


@dataclass(frozen=True)
class ThrowRecording:
    """A recording of one throw with its properties (χ, bounces, verdict and others)."""

    name: str
    path: Path
    properties: dict[str, Any]


def find_recordings(places: Sequence[Path]) -> tuple[ThrowRecording, ...]:
    """Every throw at these places, in their order, with distinct names.

    Raises FileNotFoundError for a place without a recording. Raises ValueError for a file that is not a recording, and for
    a recording that is given twice.
    """
    paths = [path for place in places for path in _recordings_at(place)]
    repeated = [path for path, count in Counter(path.resolve() for path in paths).items() if count > 1]
    if repeated:
        raise InputError(f"{repeated[0]} is given twice; give each throw once")
    names = _names(paths)
    return tuple(ThrowRecording(name, path, _properties(path)) for name, path in zip(names, paths, strict=True))


def join(found: Sequence[ThrowRecording], out: Path, *, align: str, models: bool | None, force: bool = False) -> bool:
    """Write one recording of all, and return whether they are treated as models of one throw.

    `models` states whether they are; None compares the footage in their provenance. `align` is BOUNCE or FRAME. Raises
    OutputExistsError if `out` exists (unless `force`), ValueError for throws that cannot be joined.
    """
    if align not in (BOUNCE, FRAME):
        raise InputError(f"--align {align}: wanted {BOUNCE} or {FRAME}")
    if len(found) < 2:
        raise InputError(f"{found[0].path} is one recording; give two or more to join, or omit --out to view one")
    same = made_from_same_footage(found) if models is None else models
    with whole_file(out, force=force, inputs=[one.path for one in found]) as file:
        check_free_space(file, _room_for(found))
        sources = [Source(one.path, one.name) for one in found]
        join_recordings(file, sources, same_throw=same, at_bounce=align == BOUNCE)
    return same


def gather(found: Sequence[ThrowRecording], out: Path, *, force: bool = False, command: tuple[str, ...] = ()) -> None:
    """Write a folder with one recording per throw, `throws.csv`, and `provenance.json`, which states `command`.

    The viewer shows the recordings as one table, a row per throw. Raises OutputExistsError if `out` exists (unless `force`).
    """
    inputs, watch = tuple(one.path for one in found), Stopwatch()
    with whole_folder(out, force=force, inputs=inputs) as folder:
        check_free_space(folder, _room_for(found))
        with watch.stage("copy"):
            for one in found:
                shutil.copyfile(one.path, folder / f"{one.name}.rrd")
        with (folder / "throws.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(("throw", *COLUMNS))
            writer.writerows((one.name, *(one.properties.get(name, "") for name in COLUMNS)) for one in found)
        understood = {"throws": [one.name for one in found]}
        write_provenance(folder, command=command, understood=understood, seconds=watch.seconds, inputs=inputs)


def _room_for(found: Sequence[ThrowRecording]) -> int:
    """Bytes that all recordings take together, and some to spare."""
    return MIN_FREE_BYTES + sum(one.path.stat().st_size for one in found)


def made_from_same_footage(found: Sequence[ThrowRecording]) -> bool:
    """Whether all have the same clip or track among the inputs in their provenance."""
    made_from = [_footage(one.path.with_name("provenance.json")) for one in found]
    return bool(made_from[0]) and all(inputs == made_from[0] for inputs in made_from)


def _footage(provenance: Path) -> frozenset[str]:
    """The checksums of a run's inputs without its scene; empty if they are unknown, as for recordings that were copied."""
    if not provenance.is_file():
        return frozenset()
    inputs = read_json(provenance).get("inputs", [])
    return frozenset(entry["sha256"] for entry in inputs if not str(entry["path"]).endswith((".toml", ".rrd")))


def _recordings_at(place: Path) -> list[Path]:
    if place.suffix == ".rrd" and place.is_file():
        return [place]
    if (place / RECORDING).is_file():
        return [place / RECORDING]
    below = sorted(place.glob(f"*/{RECORDING}")) or sorted(place.glob("*.rrd"))
    if not below:
        wanted = f"wanted a folder with {RECORDING}, as analyze writes it, or a folder of such folders"
        raise FileNotFoundError(f"{place}: no recording of a throw found; {wanted}")
    return below


def _names(paths: Sequence[Path]) -> list[str]:
    """The name of the folder or file of each, with as much of the path as makes the names distinct."""
    parts = [
        path.resolve().parent.parts if path.name == RECORDING else path.resolve().with_suffix("").parts
        for path in paths
    ]
    for depth in range(1, max(len(part) for part in parts) + 1):
        names = ["_".join(part[-depth:]).strip("/") for part in parts]
        if len(set(names)) == len(names):
            break
    return names


def _properties(path: Path) -> dict[str, Any]:
    try:
        return properties_of(path)
    except (RuntimeError, ValueError) as error:
        raise InputError(f"{path}: not a Rerun recording ({error})") from error
