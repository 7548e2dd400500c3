"""Several recordings joined in one: several throws on one clock, or several models of one throw.

The chunks of each recording are copied with three changes: the entity path, the time (all clocks are aligned at one
instant), and the colour. Nothing is decoded or computed again, so videos, poses and bounces keep every digit.

| | several throws | several models |
| --- | --- | --- |
| video, measured die | of each throw | of the first recording |
| `world/measured/die` | `world/NAME/measured/die` | unchanged |
| `world/simulated/die` | `world/NAME/simulated/die` | `world/NAME/die` |
| `plots/spin/measured` | `plots/spin/NAME/measured` | unchanged |
| colours | one for each throw, paler for its model | that of the measured die, and one for each model |
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import Chunk, RrdReader

from ...model.errors import InputError
from ..elements import BLACK, MEASURED, SIMULATED, THROW_COLOURS, WHITE, Colour, mixed
from .scenery import eye_of, send_table
from .several_throws_blueprint import JoinedContents, JoinedThrow, views_of
from .throw_recording import open_recording
from .timelines import on_frames

Array = NDArray[np.float64]

COLOUR_COLUMNS = (":colors", ":vertex_colors", ":color")
MODEL_WHITENING = 0.45
"""Share of white in the colour of a throw's model."""
COLOUR_ROUNDING = 2
"""Largest difference in red, green or blue that rounding causes."""
REPLACED = ("/__properties", "/world/table")
"""Entities of each recording that the joined recording replaces by its own."""
SAME_FPS = 1e-6
"""Relative difference of frame rates below which frames can be counted on one timeline."""
DEFAULT_RADIUS_M = 0.01
"""Radius of a die whose recording has no mesh."""


@dataclass(frozen=True, eq=False)
class Source:
    """A recording to be joined with others."""

    path: Path
    name: str
    """Name that distinguishes it from the others."""


@dataclass(frozen=True, eq=False)
class _LoadedRecording:
    """A recording with the properties that joining needs."""

    name: str
    """As a part of an entity path."""
    title: str
    chunks: list[Chunk]
    identity: str
    box_m: Array
    """(2, 3) lowest and highest corner of the box that contains the die and touches the table."""
    radius_m: float
    """Radius of the sphere through the corners of the die."""
    fps: float
    bounce: tuple[int, int] | None
    """Time [ns] and frame of the first bounce; None without one."""
    span: tuple[int, int]
    """Times of the first and the last pose [ns]."""
    frames: tuple[int, int]
    """First and last frame with a pose."""

    def has(self, entity: str) -> bool:
        """Whether the recording has data at an entity or below it."""
        return any(c.entity_path == entity or c.entity_path.startswith(entity + "/") for c in self.chunks)

    def rows(self, entity: str, component: str, timeline: str) -> Iterator[tuple[Any, Any]]:
        """Times and values of one component on one timeline."""
        for chunk in self.chunks:
            if chunk.entity_path == entity and timeline in chunk.timeline_names:
                batch = chunk.to_record_batch()
                if component in batch.schema.names:
                    yield _times(batch, timeline), batch.column(component)


def join_recordings(out: Path, sources: Sequence[Source], *, same_throw: bool = False, at_bounce: bool = True) -> None:
    """Write one recording that joins several; with `same_throw` they are models of one throw.

    With `at_bounce` the first bounces of several throws coincide, otherwise their frames 0. Raises ValueError for a file
    that is not the recording of a throw, FileNotFoundError for a missing file.
    """
    names = [source.name for source in sources]
    if len(set(names)) < len(names):
        raise InputError(f"two recordings have the same name, among {', '.join(names)}; give each its own name")
    reads = [_read(source) for source in sources]
    shifts = [(0, 0)] * len(reads) if same_throw or not at_bounce else _shifts(reads)
    joined = _joined(reads, shifts, same_throw)
    identity = hashlib.sha256(" ".join(read.identity for read in reads).encode()).hexdigest()[:8]
    title = f"{len(reads)} {'models' if same_throw else 'throws'}"
    with open_recording(out, title, f"{title.replace(' ', '-')}-{identity}", views_of(joined)) as recording:
        send_table(recording, joined.low_m, joined.high_m)
        for k, (read, shift, entry) in enumerate(zip(reads, shifts, joined.entries, strict=True)):
            move = _ChunkRewriter(read, shift, entry, same_throw, first=k == 0, counts_frames=joined.counts_frames)
            for chunk in read.chunks:
                moved = move.chunk(chunk)
                if moved is not None:
                    rr.send_chunks(moved, recording=recording)
            if not same_throw:
                _send_lowest(recording, read, shift, entry, joined.counts_frames)
        recording.log("report/table", rr.TextDocument(_table(reads), media_type=rr.MediaType.MARKDOWN), static=True)


def properties_of(path: Path) -> dict[str, Any]:
    """The properties that a recording contains: χ, bounces, verdict and others; absent ones are left out."""
    return _properties(list(RrdReader(path).stream().filter(content="/__properties/throw")))


def _properties(chunks: Sequence[Chunk]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for batch in (chunk.to_record_batch() for chunk in chunks if chunk.entity_path == "/__properties/throw"):
        for name in batch.schema.names:
            values = batch.column(name).to_pylist()
            if not name.startswith("rerun.") and values and values[-1]:
                found[name] = values[-1][0]
    return found


def entity_name(title: str) -> str:
    """A title as one part of an entity path, which allows some characters only."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", title)


# --- reading ---


def _read(source: Source) -> _LoadedRecording:
    if not source.path.is_file():
        raise FileNotFoundError(f"{source.path}: no such recording")
    try:
        reader = RrdReader(source.path)
        recordings = reader.recordings()
        chunks = list(reader.stream())
    except (RuntimeError, ValueError) as error:
        raise InputError(f"{source.path}: not a Rerun recording ({error})") from error
    poses = [_poses(chunks, f"/world/{motion}/die") for motion in ("measured", "simulated")]
    known = [pose for pose in poses if pose is not None]
    if not known or not recordings:
        raise InputError(f"{source.path}: this recording has no moving die; wanted the replay.rrd of a throw")
    times, frames, positions = known[0]
    box = np.array([positions.min(0), positions.max(0)])
    radius = _radius(chunks)
    box += np.array([[-radius] * 3, [radius] * 3])
    box[0, 2] = 0.0
    fps = 1e9 * float(frames[-1] - frames[0]) / max(float(times[-1] - times[0]), 1.0)
    return _LoadedRecording(
        entity_name(source.name),
        source.name,
        chunks,
        recordings[0].recording_id,
        box,
        radius,
        fps,
        _first_bounce(chunks),
        (int(times[0]), int(times[-1])),
        (int(frames[0]), int(frames[-1])),
    )


def _poses(chunks: Sequence[Chunk], entity: str) -> tuple[NDArray[np.int64], NDArray[np.int64], Array] | None:
    """Times [ns], frames and positions [m] of the poses at an entity."""
    for chunk in chunks:
        batch = chunk.to_record_batch() if chunk.entity_path == entity else None
        if batch is not None and "Transform3D:translation" in batch.schema.names:
            positions = np.array([value[0] for value in batch.column("Transform3D:translation").to_pylist()], float)
            return _times(batch, "t"), _times(batch, "frame"), positions
    return None


def _radius(chunks: Sequence[Chunk]) -> float:
    """Radius of the sphere through the corners of the die [m]."""
    for chunk in chunks:
        if chunk.entity_path.endswith("/die") and "Mesh3D:vertex_positions" in chunk.to_record_batch().schema.names:
            corners = chunk.to_record_batch().column("Mesh3D:vertex_positions").to_pylist()[0]
            return float(np.linalg.norm(np.array(corners, float), axis=1).max())
    return DEFAULT_RADIUS_M


def _first_bounce(chunks: Sequence[Chunk]) -> tuple[int, int] | None:
    """Time [ns] and frame of the first bounce in the event log, of the measured die if it has one."""
    for motion in ("measured", "simulated"):
        firsts = {}
        for chunk in chunks:
            if chunk.entity_path == f"/events/{motion}":
                for timeline in chunk.timeline_names:
                    firsts[timeline] = int(_times(chunk.to_record_batch(), timeline).min())
        if {"t", "frame"} <= firsts.keys():
            return firsts["t"], firsts["frame"]
    return None


def _times(batch: pa.RecordBatch, timeline: str) -> NDArray[np.int64]:
    return np.asarray(batch.column(timeline).cast(pa.int64())).astype(np.int64)


def _shifts(reads: Sequence[_LoadedRecording]) -> list[tuple[int, int]]:
    """Nanoseconds and frames to add to each recording, none negative, so that all first bounces coincide."""
    bounces = [read.bounce for read in reads]
    missing = [read.title for read in reads if read.bounce is None]
    if missing:
        raise InputError(f"{missing[0]} has no bounce at which the clocks could be aligned; try --align frame")
    last_t, last_frame = (max(bounce[k] for bounce in bounces if bounce) for k in (0, 1))
    return [(last_t - bounce[0], last_frame - bounce[1]) for bounce in bounces if bounce]


def _joined(reads: Sequence[_LoadedRecording], shifts: Sequence[tuple[int, int]], same_throw: bool) -> JoinedContents:
    """The description from which the views are made."""
    low = np.min([read.box_m[0] for read in reads], axis=0)
    high = np.max([read.box_m[1] for read in reads], axis=0)
    counts = all(abs(read.fps / reads[0].fps - 1.0) < SAME_FPS for read in reads)
    spans = [
        [time + shift[0] for time in read.span] if not counts else [frame + shift[1] for frame in read.frames]
        for read, shift in zip(reads, shifts, strict=True)
    ]
    return JoinedContents(
        entries=tuple(_entry(read, k, same_throw) for k, read in enumerate(reads)),
        same_throw=same_throw,
        low_m=low,
        high_m=high,
        eye_m=eye_of(low, high),
        radius_m=max(read.radius_m for read in reads),
        fps=reads[0].fps,
        counts_frames=counts,
        played=(min(begin for begin, _ in spans), max(end for _, end in spans)),
    )


def _entry(read: _LoadedRecording, k: int, same_throw: bool) -> JoinedThrow:
    colour = THROW_COLOURS[(k + 1 if same_throw else k) % len(THROW_COLOURS)]
    return JoinedThrow(
        read.name,
        read.title,
        colour if not same_throw else MEASURED,
        colour if same_throw else mixed(colour, WHITE, MODEL_WHITENING),
        measured=read.has("/world/measured/die"),
        simulated=read.has("/world/simulated/die"),
        video=read.has("/world/camera/image"),
        odds=read.has("/plots/odds"),
    )


# --- moving chunks ---


@dataclass(frozen=True, eq=False)
class _ChunkRewriter:
    """Changes the chunks of one recording to their entity path, time and colour in the joined one."""

    read: _LoadedRecording
    shift: tuple[int, int]
    """Nanoseconds and frames to add."""
    entry: JoinedThrow
    same_throw: bool
    first: bool
    counts_frames: bool

    def chunk(self, chunk: Chunk) -> Chunk | None:
        """The changed chunk; None if the joined recording leaves it out."""
        entity = self._entity(chunk.entity_path)
        if entity is None:
            return None
        batch = chunk.to_record_batch()
        if chunk.timeline_names == ["frame"] and not self.counts_frames:
            return None
        if "frame" in batch.schema.names and not self.counts_frames:
            batch = batch.drop_columns(["frame"])
        for timeline, shift in zip(("t", "frame"), self.shift, strict=True):
            if timeline in batch.schema.names:
                batch = _replaced(batch, timeline, _times(batch, timeline) + shift)
        for name in batch.schema.names:
            if name.endswith(COLOUR_COLUMNS):
                batch = _mapped(batch, name, partial(self._colours, chunk.entity_path))
            elif name.endswith(":names"):
                batch = _mapped(batch, name, self._names)
            elif name == "TextLog:text":
                batch = _mapped(batch, name, self._sentences)
        (moved,) = Chunk.from_record_batch(batch)
        return moved.with_entity_path(entity)

    def _entity(self, path: str) -> str | None:
        if path == "/world" or path.startswith(REPLACED):
            return None
        parts = path.split("/")
        if path.startswith("/report"):
            return f"/report/{self.read.name}"
        if not self.same_throw:
            kind = 3 if path.startswith("/plots") else 2
            return "/".join([*parts[:kind], self.read.name, *parts[kind:]])
        if "simulated" in parts:
            return "/".join(self.read.name if part == "simulated" else part for part in parts)
        if path.startswith(("/plots/residual", "/plots/chi/estimate", "/plots/odds", "/events/told")):
            return "/".join([*parts[:3], self.read.name, *parts[3:]])
        return path if self.first else None

    def _colours(self, entity: str, values: list[int]) -> list[int]:
        # Residuals of a model have the colour of that model.
        of_model = self.same_throw and entity.startswith("/plots/residual")
        measured = self.entry.simulated_colour if of_model else self.entry.measured_colour
        return [self._colour(value, measured) for value in values]

    def _colour(self, packed: int, measured: Colour) -> int:
        rgb: Colour = (packed >> 24 & 255, packed >> 16 & 255, packed >> 8 & 255)
        for old, new in ((MEASURED, measured), (SIMULATED, self.entry.simulated_colour)):
            found = recoloured(rgb, old, new)
            if found is not None:
                red, green, blue = found
                return red << 24 | green << 16 | blue << 8 | packed & 255
        return packed

    def _sentences(self, values: list[str]) -> list[str]:
        """Lines of the event log with the title; measured bounces are common to all models of one throw."""
        shared = self.same_throw and values[0].startswith("measured")
        return values if shared else [f"{self.read.title}: {value}" for value in values]

    def _names(self, values: list[str]) -> list[str]:
        mine = self.read.title
        if not self.same_throw:
            words = {"measured": mine, "simulated": f"{mine}, model"}
        else:
            words = {"measured": "measured", "simulated": mine}
        named = []
        for value in values:
            first, space, rest = value.partition(" ")
            own = self.same_throw and not value.startswith(("fit ", "all "))
            named.append(words[first] + space + rest if first in words else value if own else f"{mine}: {value}")
        return named


def recoloured(rgb: Colour, old: Colour, new: Colour) -> Colour | None:
    """The tint or shade of `new` that corresponds to `rgb` as one of `old`; None if `rgb` is neither."""
    for extreme in (WHITE, BLACK):
        difference = np.subtract(extreme, old)
        share = float(np.subtract(rgb, old) @ difference) / float(difference @ difference)
        if -0.01 <= share <= 0.9 and np.abs(np.subtract(mixed(old, extreme, share), rgb)).max() <= COLOUR_ROUNDING:
            return mixed(new, extreme, max(share, 0.0))
    return None


def _replaced(batch: pa.RecordBatch, name: str, values: NDArray[np.int64]) -> pa.RecordBatch:
    k = batch.schema.names.index(name)
    column = batch.schema.field(k)
    return batch.set_column(k, column, pa.array(values).cast(column.type))


def _mapped(batch: pa.RecordBatch, name: str, change: Any) -> pa.RecordBatch:
    """The batch with `change` applied to every list of a column, once for equal lists."""
    k = batch.schema.names.index(name)
    column, known = batch.schema.field(k), {}
    rows = []
    for row in batch.column(k).to_pylist():
        if row is not None and tuple(row) not in known:
            known[tuple(row)] = change(row)
        rows.append(None if row is None else known[tuple(row)])
    return batch.set_column(k, column, pa.array(rows, column.type))


# --- added to the joined recording ---


def _send_lowest(
    recording: rr.RecordingStream,
    read: _LoadedRecording,
    shift: tuple[int, int],
    entry: JoinedThrow,
    counts_frames: bool,
) -> None:
    """The height of the lowest corner, one curve per throw: the curves of all corners would hide each other."""
    for motion, colour in (("measured", entry.measured_colour), ("simulated", entry.simulated_colour)):
        for chunk in read.chunks:
            batch = chunk.to_record_batch() if chunk.entity_path == f"/plots/height/{motion}" else None
            if batch is None or "Scalars:scalars" not in batch.schema.names:
                continue
            entity = f"plots/lowest/{read.name}/{motion}"
            label = read.title + (", model" if motion == "simulated" else "")
            recording.log(entity, rr.SeriesLines(colors=colour, names=label, widths=1.5), static=True)
            times, frames = _times(batch, "t") + shift[0], _times(batch, "frame") + shift[1]
            index = on_frames(frames, 1e-9 * times.astype(np.float64))
            lowest = [min(row) for row in batch.column("Scalars:scalars").to_pylist()]
            columns = rr.Scalars.columns(scalars=lowest)
            recording.send_columns(entity, index if counts_frames else index[1:], columns)


def _table(reads: Sequence[_LoadedRecording]) -> str:
    """One row per recording, for the first page of the report."""
    lines = ["| | χ | 95 % interval | bounces | explained | residuals [σ] |", "| --- | --- | --- | --- | --- | --- |"]
    for read in reads:
        properties = _properties(read.chunks)
        chi, low, high, rms = (properties.get(name) for name in ("chi", "chi_low", "chi_high", "residual_rms"))
        cells = [
            read.title,
            "" if chi is None else f"{chi:.5g}",
            "" if low is None or high is None else f"{low:.5g} to {high:.5g}",
            *(str(properties.get(name, "")) for name in ("bounces", "bounces_fitted")),
            "" if rms is None else f"{rms:.2f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)
