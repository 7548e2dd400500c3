"""Reads videos in any container and codec of FFmpeg, through PyAV: every frame exactly once, at its native depth.

The packets are listed once without decoding, because the frame counts in containers are often wrong. A frame is found by its
place in the film: decoding starts at a key packet, recognised by its offset in the file, and the decoded frames are counted.
Timestamps cannot identify frames: with a time base of 1 ms (Matroska), two frames of a 1500 frames/s film have the same one.

**Grey levels** are the luma plane at full scale. Video with chroma is stored in limited range (16 to 235 in 8 bit) unless its tag
declares full range, and is expanded. Monochrome video is stored at full scale whatever its tag declares: FFmpeg marks
monochrome HEVC as limited by default, and decodes monochrome H.264 as untagged yuv420p, so the parameter set of the stream
decides. A wrong choice changes grey levels by up to 20. RGB becomes luma with the weights of ITU-R BT.601.

**Times** are t = k / fps. The timestamps of the container are for playback, and serve as a check: a notice reports uneven ones.
Uneven timestamps that run at the recording rate and are fine enough show dropped frames, and are used as the frames' times; of
coarser ones (a telephone's 1/600 s at 240 frames/s) the whole frame intervals between them are used.

**The display matrix** of a file says how players turn its frames. Quarter turns are done, as players and OpenCV do them, because
calibrations are made on such pictures; `as_stored` leaves them out. A matrix [a b; c d] takes (x, y) to (a x + c y, b x + d y)
with y down. Mirroring matrices and other angles are not followed. Every case has a notice, and so have frames that the edit
list of a trimmed film leaves out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import chain, islice
from pathlib import Path
from typing import Any

import av
import av.filter
import cv2
import numpy as np
from av.sidedata.sidedata import Type as SideDataType
from numpy.typing import NDArray

from ...model.errors import InputError
from .reader import AS_STORED, TURNED, Footage, Frame, check_size, times_from_rate

REFUSED_FORMATS = {"tty", "concat", "hls", "dash", "image2", "imf", "webm_dash_manifest"}
"""Formats of FFmpeg that are not films: text, and lists that make it open other files."""
LUMA_FIRST = re.compile(
    r"(gray(8|9|10|12|14|16)?(le|be)?|yuvj?4\d\dp(9|1\d)?(le|be)?|yuva4\d\dp(9|1\d)?(le|be)?|nv\d\d)$"
)
"""Pixel formats whose first plane is luma only, in the low bits."""
FULL_RANGE = 2
"""FFmpeg's AVCOL_RANGE_JPEG."""
MAX_ROUNDING_TICKS = 2.0
"""Deviation of the timestamps that rounding explains: half a tick for each time, and one for the mean rate over the film."""
MAX_WANDER_FRAMES = 0.1
"""Deviation beyond the rounding, in frames, up to which timestamps count as even."""
SAME_RATE = 0.01
"""Largest relative difference of the timestamps' rate from the recording rate, for use as the frames' times."""
MAX_TICK_FRAMES = 0.2
"""Largest tick, in frames, of timestamps that are used as the frames' times: a coarser one blurs the motion."""
MAX_COUNTING_TICK_FRAMES = 0.45
"""Largest tick, in frames, of timestamps that tell how many frame intervals lie between two frames: both are rounded by half of
one."""
MAX_TURN_ERROR_DEG = 0.5
"""Deviation from a quarter turn up to which a display matrix counts as one: its elements are stored to 1/65536."""


def open_video(
    path: Path, fps: float | None, frame_range: tuple[int, int] | None, *, as_stored: bool = False
) -> Footage:
    """The clip in a container. Raises ValueError where FFmpeg finds none, or where fps is missing."""
    return VideoClip(path, fps, frame_range, as_stored=as_stored)


@dataclass(frozen=True, eq=False)
class Packets:
    """The packets of a film in decoding order, one row each."""

    offset: NDArray[np.int64]
    """Offset in the file [bytes], -1 where unknown."""
    time: NDArray[np.int64]
    """Presentation timestamp, or else decoding timestamp, in ticks of the time base."""
    key: NDArray[np.bool_]
    """Whether decoding can begin here."""
    broken: bool
    """Whether the list ends at damage."""
    hidden: int = 0
    """Number of frames that the edit list of the file leaves out."""

    @property
    def rank(self) -> NDArray[np.int64]:
        """(n,) place in the film of each key packet's frame: the number of frames that are shown before it."""
        n = len(self.time)
        later_minimum = np.minimum.accumulate(self.time[::-1])[::-1]
        rank = np.arange(n)
        for i in np.flatnonzero(self.key & (later_minimum < self.time)):
            rank[i] += np.count_nonzero(self.time[i + 1 :] < self.time[i])
        return rank


class VideoClip(Footage):
    """A video clip; the module states how frames, grey levels and times are found."""

    in_any_order = False

    def __init__(
        self, path: Path, fps: float | None, frame_range: tuple[int, int] | None, *, as_stored: bool = False
    ) -> None:
        self._container, self._video = _open(path)
        stream = self._video
        check_size(path, stream.codec_context.width, stream.codec_context.height)
        self._packets = _list_packets(self._container, stream)
        self._rank = self._packets.rank
        self._index_at = {int(p): i for i, p in enumerate(self._packets.offset)}
        self._mono = _is_monochrome_h264(stream.codec_context)
        self._decoded: Iterator[tuple[int, av.VideoFrame]] = iter(())
        self._next_number = -1
        self._kept = None  # until the size of the frames is known
        self.path = path
        count = self._count_readable()
        sample = self._decode(0)
        stream = self._video  # decoding may have opened the file anew
        facts = _facts(self._container, stream, sample)
        display = _display(sample)
        self._quarter_turns = 0 if as_stored else display.quarter_turns or 0
        playback = f"only a playback rate ({facts['playback_fps']:g} frames/s)" if facts["playback_fps"] else "no rate"
        times = times_from_rate(path, fps, count, playback)
        time_base_s = float(stream.time_base or 0)
        times, notices, stamped = _times(
            path, times, np.asarray(np.sort(self._packets.time)[:count] * time_base_s, np.float64), time_base_s
        )
        grey = self._upright(sample)
        super().__init__(
            path,
            width_px=grey.shape[1],
            height_px=grey.shape[0],
            bit_depth=_bit_depth(sample),
            file_times_s=times,
            frame_range=frame_range,
            notices=self._truncation_notices(count) + display.notices(path, grey, self._quarter_turns) + notices,
            facts={**facts, "time_stamps": stamped, "turned_deg": 90 * self._quarter_turns},
        )

    def _read(self, number: int) -> Frame:
        frame = self._upright(self._decode(number))
        if frame.shape != (self.height_px, self.width_px):
            h, w = frame.shape
            raise InputError(
                f"{self.path.name}: frame {number} has {w} × {h} px; wanted the first one's {self.width_px} × {self.height_px}; "
                "cut the film where its size changes"
            )
        return frame

    def _keep_on_the_way(self, number: int, decoded: av.VideoFrame) -> None:
        """Keep a frame that was decoded to reach a later one, where frames are kept: it will be asked for as well."""
        index = number - self.first_frame if self._kept is not None else -1
        if 0 <= index < len(self) and not self._is_kept[index]:
            grey = self._upright(decoded)
            if grey.shape == (self.height_px, self.width_px):
                self._keep(number, grey)

    def _upright(self, decoded: av.VideoFrame) -> Frame:
        """Grey levels of a frame, turned as the file asks players to."""
        grey = _grey(decoded, self._mono)
        if self._quarter_turns == 0:
            return grey
        return np.rot90(grey, self._quarter_turns).copy()

    def _decode(self, number: int) -> av.VideoFrame:
        """Decode up to frame `number`, from the key packet before it unless the decoder is nearer."""
        keys = np.flatnonzero(self._packets.key)
        before = keys[self._rank[keys] <= number]
        key = int(before[-1]) if len(before) else 0
        if not self._rank[key] <= self._next_number <= number:
            self._decoded = self._decode_from(key)
        self._next_number = -1  # stays so if decoding fails
        try:
            for place, frame in self._decoded:
                if place == number:
                    self._next_number = number + 1
                    return frame
                self._keep_on_the_way(place, frame)
        except av.error.FFmpegError as error:
            raise InputError(f"{self.path.name}: frame {number} cannot be decoded; {_hint(number)}") from error
        raise InputError(f"{self.path.name}: frame {number} is missing from the film; {_hint(number)}")

    def _decode_from(self, key: int) -> Iterator[tuple[int, av.VideoFrame]]:
        """Frames from a key packet on, each with its place in the film."""
        packets, decoder = self._packets_from(key), self._video.codec_context
        place, begin = int(self._rank[key]), self._packets.time[key]
        has_leading = place > key
        for packet in packets:
            for frame in decoder.decode(packet):
                if has_leading and frame.pts is not None and frame.pts < begin:
                    continue  # shown before the key frame, and damaged without the frames before that
                yield place, frame
                place += 1

    def _packets_from(self, key: int) -> Iterator[av.Packet | None]:
        """The packets from number `key` on, then None, which flushes the decoder."""
        container, stream = self._container, self._video
        try:
            container.seek(int(self._packets.time[key]), stream=stream, backward=True)
            packets = _filled(container.demux(stream))
            first = next(packets, None)
            found = self._index_at.get(first.pos, key + 1) if first is not None and first.pos >= 0 else key + 1
        except av.error.FFmpegError:
            found = key + 1  # some containers cannot seek; they are read from their beginning
        if found <= key:
            return chain(islice(chain([first], packets), key - found, None), [None])
        container.close()
        self._container, self._video = _open(self.path)
        return chain(islice(_filled(self._container.demux(self._video)), key, None), [None])

    def _count_readable(self) -> int:
        """Number of frames, without those at the end of a damaged file that cannot be decoded."""
        count = len(self._packets.time)
        while self._packets.broken and count > 0:
            try:
                self._decode(count - 1)
                return count
            except ValueError:
                count -= 1
        if count == 0:
            raise InputError(f"{self.path.name}: no frame can be decoded; the file is empty or damaged, copy it again")
        return count

    def _truncation_notices(self, count: int) -> tuple[str, ...]:
        declared, hidden = self._video.frames, self._packets.hidden
        if hidden and not self._packets.broken:
            return (
                f"{self.path.name}: the edit list of the file leaves out {hidden} of {count + hidden} frames (a trimmed film); "
                "the others are used.",
            )
        if count < declared:
            return (
                f"{self.path.name}: the file declares {declared} frames and {count} can be read; "
                "it seems cut off, and those are used.",
            )
        return (
            (f"{self.path.name}: the end of the file is damaged; {count} frames are used.",)
            if self._packets.broken
            else ()
        )


def _hint(number: int) -> str:
    return f"repair the file, or restrict frames to [0, {number}]" if number else "the file is damaged"


def _open(path: Path) -> tuple[av.container.InputContainer, av.VideoStream]:
    try:
        container = av.open(f"file:{path.resolve()}", options={"protocol_whitelist": "file"})
    except (av.error.FFmpegError, OSError) as error:
        raise InputError(
            f"{path.name}: FFmpeg finds no film in it; give a film, pictures or a Photron header"
        ) from error
    if not container.streams.video or REFUSED_FORMATS & set(container.format.name.split(",")):
        name = container.format.name
        container.close()
        raise InputError(
            f"{path.name}: a file of the kind {name!r} holds no film; give a film, pictures or a Photron header"
        )
    stream = container.streams.video[0]
    if stream.codec_context is None:
        container.close()
        raise InputError(f"{path.name}: FFmpeg has no decoder for it; save it again, as FFV1 for example")
    stream.thread_type = "AUTO"
    return container, stream


def _filled(packets: Iterator[av.Packet]) -> Iterator[av.Packet]:
    """The packets with content: empty ones mark dropped frames in AVI, and the end in PyAV."""
    return (packet for packet in packets if packet.size and not packet.is_corrupt)


def _list_packets(container: av.container.InputContainer, stream: av.VideoStream) -> Packets:
    """Read all packets once, without decoding."""
    rows: list[tuple[int, int, bool]] = []
    broken = False
    try:
        for packet in container.demux(stream):
            broken |= packet.is_corrupt
            if packet.size and not packet.is_corrupt and not packet.is_discard:
                time = packet.pts if packet.pts is not None else packet.dts
                rows.append(
                    (-1 if packet.pos is None else packet.pos, len(rows) if time is None else time, packet.is_keyframe)
                )
    except av.error.FFmpegError:
        broken = True  # the packets before are readable, and a notice reports the damage
    offset, time, key = (np.array([row[i] for row in rows]) for i in range(3)) if rows else (np.empty(0),) * 3
    if len(key):
        key[0] = True  # decoding has to begin there
    hidden = _hidden_frames(container, stream, len(rows)) if not broken and len(rows) < stream.frames else 0
    return Packets(
        offset.astype(np.int64),
        time.astype(np.int64),
        key.astype(bool),
        broken or len(rows) + hidden < stream.frames,
        hidden,
    )


def _hidden_frames(container: av.container.InputContainer, stream: av.VideoStream, shown: int) -> int:
    """Number of frames that an edit list leaves out: those that the demuxer hands out without it, beyond the `shown` ones."""
    if "mov" not in container.format.name.split(","):
        return 0
    options = {"protocol_whitelist": "file", "ignore_editlist": "1"}
    try:
        with av.open(container.name, options=options) as whole:
            packets = _filled(whole.demux(whole.streams[stream.index]))
            return max(sum(1 for _ in packets) - shown, 0)
    except av.error.FFmpegError:
        return 0  # damaged; the caller counts what it has


@dataclass(frozen=True)
class _Display:
    """What a file asks players to do with its frames."""

    turn_deg: float
    """Counter-clockwise."""
    mirrored: bool

    @property
    def quarter_turns(self) -> int | None:
        """Number of quarter turns counter-clockwise, 0 to 3; None for a mirrored picture or another angle."""
        turns = round(self.turn_deg / 90.0)
        if self.mirrored or abs(self.turn_deg - 90.0 * turns) > MAX_TURN_ERROR_DEG:
            return None
        return turns % 4

    def notices(self, path: Path, frame: Frame, turns_done: int) -> tuple[str, ...]:
        """A notice where the file asks for a change; `frame` is one as it is used, after so many quarter turns."""
        if self.quarter_turns == 0:
            return ()
        height, width = frame.shape
        size = f"{width} × {height} px"
        if turns_done:
            return (
                f"{path.name}: the frames are turned by {_turn_text(self.turn_deg)}, {TURNED}, to {size}; "
                "camera and background must be of turned frames.",
            )
        asked = f"turn its frames by {_turn_text(self.turn_deg)}"
        if self.mirrored:
            asked = "mirror its frames"
        return (
            f"{path.name}: the file asks players to {asked}; the frames are used {AS_STORED}, {size}, and camera and background "
            "must be of stored frames.",
        )


def _turn_text(turn_deg: float) -> str:
    """`90° clockwise`; a half turn has no direction."""
    size = f"{abs(turn_deg):.4g}°"
    return size if abs(turn_deg) > 180.0 - MAX_TURN_ERROR_DEG else f"{size} {'counter-' * (turn_deg > 0)}clockwise"


def _display(sample: av.VideoFrame) -> _Display:
    """The turn and the mirroring of a frame's display matrix."""
    stated = sample.side_data.get(SideDataType.DISPLAYMATRIX)
    if stated is None:
        return _Display(0.0, False)
    (a, b), (c, d) = np.frombuffer(bytes(stated), np.int32).reshape(3, 3)[:2, :2].astype(float)
    return _Display(float(np.degrees(np.arctan2(-b, a))), bool(a * d - b * c < 0.0))


def _times(
    path: Path, even_s: NDArray[np.float64], playback_s: NDArray[np.float64], time_base_s: float
) -> tuple[NDArray[np.float64], tuple[str, ...], bool]:
    """Frame times, notices on them, and whether the times are those of the container, from k / fps and the container's own times
    (both (n,) [s])."""
    if len(even_s) < 3 or playback_s[-1] <= playback_s[0]:
        return even_s, (), False
    k = np.arange(len(even_s))
    mean_s = (playback_s[-1] - playback_s[0]) / k[-1]
    tick_s = _tick(playback_s, time_base_s)
    wander_s = np.ptp(playback_s - k * mean_s)
    if wander_s <= MAX_ROUNDING_TICKS * tick_s + MAX_WANDER_FRAMES * mean_s:
        return even_s, (), False
    step_s = float(np.median(np.diff(playback_s)))
    uneven = f"{path.name}: the timestamps are uneven (a variable frame rate, or dropped frames)"
    interval_s = even_s[1]
    if abs(step_s - interval_s) <= SAME_RATE * interval_s and tick_s <= MAX_TICK_FRAMES * interval_s:
        times_s, used = playback_s - playback_s[0], "and are used as the frames' times"
        return times_s, (f"{uneven}; they run at the recording rate, {used}.",), True
    whole = np.rint(np.diff(playback_s) / interval_s)
    # Rounded steps have another median than the interval; their commonest whole number of intervals is one at this rate.
    at_rate = np.median(whole) == 1.0 and abs(_common_step(playback_s, whole) - interval_s) <= SAME_RATE * interval_s
    if at_rate and (whole >= 1.0).all() and tick_s <= MAX_COUNTING_TICK_FRAMES * interval_s:
        times_s = interval_s * np.concatenate([[0.0], np.cumsum(whole)])
        used = "and the whole frame intervals between them are used"
        return times_s, (f"{uneven}; they run at the recording rate, {used}.",), True
    return even_s, (f"{uneven}; the frames count as evenly spaced at fps.",), False


def _common_step(playback_s: NDArray[np.float64], whole: NDArray[np.float64]) -> float:
    """Mean interval [s] of timestamps whose steps (n - 1,) are so many intervals."""
    return float((playback_s[-1] - playback_s[0]) / max(whole.sum(), 1.0))


def _tick(times_s: NDArray[np.float64], time_base_s: float) -> float:
    """The rounding of the timestamps [s]: the time base, or more where frames share one (a film that was once in Matroska)."""
    steps = np.diff(times_s)
    return float(steps[steps > 0].min()) if (steps == 0).any() else time_base_s


def _facts(container: av.container.InputContainer, stream: av.VideoStream, sample: av.VideoFrame) -> dict[str, Any]:
    return {
        "format": container.format.name,
        "codec": stream.codec_context.name,
        "pixel_format": sample.format.name,
        "playback_fps": float(stream.average_rate) if stream.average_rate else None,
        "declared_frames": stream.frames or None,
    }


def _bit_depth(frame: av.VideoFrame) -> int:
    """Significant bits of the grey levels that `_grey` returns for such a frame."""
    if LUMA_FIRST.match(frame.format.name):
        return int(frame.format.components[0].bits)
    return 8 if max(c.bits for c in frame.format.components) <= 8 else 16


def _grey(frame: av.VideoFrame, mono: bool) -> Frame:
    """(height, width) grey levels at full scale."""
    if frame.planes[0].line_size < 0:
        return _grey(_flipped(frame), mono)[::-1].copy()
    name = frame.format.name
    if LUMA_FIRST.match(name):
        depth = int(frame.format.components[0].bits)
        luma = _plane(frame, depth, big_endian=name.endswith("be"))
        as_stored = mono or name.startswith(("gray", "yuvj")) or int(frame.color_range) == FULL_RANGE
        if as_stored:
            return luma
        expanded: Frame = _expansion(depth)[luma]
        return expanded
    if re.search(r"f(16|32|64)?(le|be)$", name):
        raise InputError(f"pixels of type {name}; wanted whole numbers; convert the film to 8, 12 or 16 bit grey")
    # All other formats (RGB, palettes, packed YUV) are converted to RGB, which FFmpeg returns at full scale.
    rgb = frame.to_ndarray(format="rgb24" if _bit_depth(frame) == 8 else "rgb48le")
    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))


def _plane(frame: av.VideoFrame, depth: int, big_endian: bool) -> Frame:
    """The first plane as a new array, without the padding of its lines."""
    dtype = np.dtype(np.uint8) if depth <= 8 else np.dtype(">u2" if big_endian else "<u2")
    plane = frame.planes[0]
    lines = np.frombuffer(plane, dtype).reshape(-1, plane.line_size // dtype.itemsize)
    whole = lines[: frame.height, : frame.width]
    return whole.astype(np.uint8) if depth <= 8 else whole.astype(np.uint16)


def _flipped(frame: av.VideoFrame) -> av.VideoFrame:
    """The frame with its lines in reverse order.

    Lines that are stored from the bottom up have a negative size, and the plane begins at the last of them: PyAV would read
    memory after the picture. FFmpeg's own flip only moves the beginning and changes the sign.
    """
    graph = av.filter.Graph()
    graph.link_nodes(
        graph.add_buffer(
            width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base or Fraction(1)
        ),
        graph.add("vflip"),
        graph.add("buffersink"),
    ).configure()
    graph.push(frame)
    flipped = graph.pull()
    assert isinstance(flipped, av.VideoFrame)
    return flipped


@lru_cache
def _expansion(depth: int) -> Frame:
    """Table from limited to full range: 16 ... 235 (times 2^(depth-8)) to 0 ... 2^depth - 1."""
    scale, top = 2 ** (depth - 8), 2**depth - 1
    level = (np.arange(top + 1) - 16 * scale) * (top / (219 * scale))
    return np.rint(np.clip(level, 0, top)).astype(np.uint8 if depth <= 8 else np.uint16)


def _is_monochrome_h264(codec: av.VideoCodecContext) -> bool:
    """Whether the sequence parameter set (ITU-T H.264, 7.3.2.1.1) says chroma_format_idc = 0."""
    if codec.name != "h264" or not codec.extradata:
        return False
    data = bytes(codec.extradata)
    # avcC (MP4, Matroska) holds the set at byte 8; a byte stream (AVI, TS) after a start code and the byte x7.
    start = (
        8 if data[0] == 1 else next((m.end() - 1 for m in re.finditer(rb"\x00\x00\x01[\x07\x27\x47\x67]", data)), -1)
    )
    if start < 0 or len(data) < start + 8 or data[start + 1] not in (100, 110, 122, 244, 44, 83, 86, 118, 128):
        return False  # the other profiles are 4:2:0
    bits = "".join(f"{byte:08b}" for byte in data[start + 4 : start + 12])
    _set_id, rest = _exp_golomb(bits)
    chroma_format, _ = _exp_golomb(rest)
    return chroma_format == 0


def _exp_golomb(bits: str) -> tuple[int, str]:
    """The first unsigned Exp-Golomb number in a string of bits, and the rest; (-1, "") where there is none."""
    zeros = len(bits) - len(bits.lstrip("0"))
    code = bits[zeros : 2 * zeros + 1]
    return (int(code, 2) - 1, bits[2 * zeros + 1 :]) if code else (-1, "")
