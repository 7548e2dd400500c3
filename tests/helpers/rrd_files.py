"""Recordings read from their chunks, without a viewer."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader

from diethrow.commands.results.viewer import viewer_program


def rows(path: Path, entity: str, component: str, timeline: str = "t") -> list[tuple[int, Any]]:
    """(time, value) of every row of one component on one timeline, in order; the static row at time -1."""
    found = []
    for chunk in RrdReader(path).stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if component not in batch.schema.names:
            continue
        values = batch.column(component).to_pylist()
        if timeline in batch.schema.names:
            times = np.asarray(batch.column(timeline)).astype(np.int64).tolist()
            found += list(zip(times, values, strict=True))
        elif not {"t", "frame"} & set(batch.schema.names):
            found += [(-1, value) for value in values]
    return sorted(found, key=lambda row: row[0])


def contents(path: Path) -> dict[tuple[str, str], list[str]]:
    """All values by entity and column, in whatever chunks they are, without the time of writing and the identities that the
    recorder draws anew each time."""
    found: dict[tuple[str, str], list[str]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if name not in ("rerun.controls.RowId", "RecordingInfo:start_time"):
                digests = (hashlib.sha256(repr(value).encode()).hexdigest() for value in column.to_pylist())
                found.setdefault((chunk.entity_path, name), []).extend(digests)
    return {key: sorted(values) for key, values in found.items()}


def entities(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(path).stream()}


def verify(path: Path) -> subprocess.CompletedProcess[str]:
    command = [*viewer_program(), "rrd", "verify", str(path)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
