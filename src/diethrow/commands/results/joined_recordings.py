"""Recordings of several throws: in one, for looking; or in one folder, for a table with a row a throw.

A throw is a folder that `analyze`, `fit` or `throw` made, or its `replay.rrd`; a folder of such folders stands for all
of them.
"""

from __future__ import annotations

import csv
import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...files.outputs import whole_file, whole_folder
from ...files.tables import read_json
from ...replay.recording import Source, join_recordings, properties_of

RECORDING = "replay.rrd"
COLUMNS = ("chi", "chi_low", "chi_high", "bounces", "bounces_fitted", "residual_rms", "landed_face", "verdict")
"""Properties of a recording that a table shows."""
BOUNCE, FRAME = "bounce", "frame"
"""By what the clocks of several throws are set."""


@dataclass(frozen=True)
class ThrowRecording:
    """A recording of one throw, and what it says of itself."""

    name: str
    path: Path
    properties: dict[str, Any]


def find_recordings(places: Sequence[Path]) -> tuple[ThrowRecording, ...]:
    """Every throw at these places, in their order, under names that differ.

    Raises FileNotFoundError where there is none, ValueError for a file that is no recording or one that is named twice.
    """
    paths = [path for place in places for path in _recordings_at(place)]
    twice = [path for path, count in Counter(path.resolve() for path in paths).items() if count > 1]
    if twice:
        raise ValueError(f"{twice[0]} is named twice; wanted each throw once")
    names = _names(paths)
    return tuple(ThrowRecording(name, path, _properties(path)) for name, path in zip(names, paths, strict=True))


def join(found: Sequence[ThrowRecording], out: Path, *, align: str, models: bool | None, force: bool = False) -> bool:
    """Write one recording of all; returns whether they were taken for models of one throw.

    `models` says whether they are; None looks at what they were made from. Raises OutputExistsError for a file that is
    there (unless `force`), ValueError for throws that cannot be joined.
    """
    if align not in (BOUNCE, FRAME):
        raise ValueError(f"--align {align}: wanted {BOUNCE} or {FRAME}")
    if len(found) < 2:
        raise ValueError(f"{found[0].path} is one recording; wanted two or more to join, or no --out to look at one")
    same = made_from_same_footage(found) if models is None else models
    with whole_file(out, force=force, inputs=[one.path for one in found]) as file:
        sources = [Source(one.path, one.name) for one in found]
        join_recordings(file, sources, same_throw=same, at_bounce=align == BOUNCE)
    return same


def gather(found: Sequence[ThrowRecording], out: Path, *, force: bool = False) -> None:
    """A folder with one recording a throw and `throws.csv`: the viewer shows them as one data set, a row a throw.

    Raises OutputExistsError for a folder that is there (unless `force`).
    """
    with whole_folder(out, force=force, inputs=[one.path for one in found]) as folder:
        for one in found:
            shutil.copyfile(one.path, folder / f"{one.name}.rrd")
        with (folder / "throws.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(("throw", *COLUMNS))
            writer.writerows((one.name, *(one.properties.get(name, "") for name in COLUMNS)) for one in found)


def made_from_same_footage(found: Sequence[ThrowRecording]) -> bool:
    """Whether all were made from the same clip or track, as their provenance says."""
    made_from = [_footage(one.path.with_name("provenance.json")) for one in found]
    return bool(made_from[0]) and all(inputs == made_from[0] for inputs in made_from)


def _footage(provenance: Path) -> frozenset[str]:
    """The checksums of what a run read, but for its scene; empty where that is not known."""
    if not provenance.is_file():
        return frozenset()
    inputs = read_json(provenance).get("inputs", [])
    return frozenset(entry["sha256"] for entry in inputs if not str(entry["path"]).endswith(".toml"))


def _recordings_at(place: Path) -> list[Path]:
    if place.suffix == ".rrd" and place.is_file():
        return [place]
    if (place / RECORDING).is_file():
        return [place / RECORDING]
    below = sorted(place.glob(f"*/{RECORDING}")) or sorted(place.glob("*.rrd"))
    if not below:
        wanted = f"wanted a folder with {RECORDING}, as analyze makes it, or a folder of such folders"
        raise FileNotFoundError(f"{place}: there is no recording of a throw; {wanted}")
    return below


def _names(paths: Sequence[Path]) -> list[str]:
    """The folder or the file of each; with more of the path where two have one name."""
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
        raise ValueError(f"{path}: not a Rerun recording ({error})") from error
