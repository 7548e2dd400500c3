"""Targets of fuzzing: small files of every format, and the readers that must read or refuse any changed file.

A target takes the bytes of one file and reads it as a command does. It returns if the file was read, or refused with a message
(ValueError, OSError); any other exception is a defect.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from footage_files import noisy_frames, write_cine, write_photron, write_tiff

from diethrow.files.fit_records import read_parameters
from diethrow.files.plan import read_plan
from diethrow.files.scene import read_scene
from diethrow.files.throw_records import read_bounces, read_track, write_track
from diethrow.model.throw.motion import State
from diethrow.tracking.footage.clip import open_clip
from diethrow.tracking.track import TRACKED, Track

SAMPLES = Path(__file__).parents[2] / "data_samples"
FRAMES = noisy_frames(3, bits=12, height=6, width=8)


@dataclass(frozen=True)
class Target:
    """One kind of file."""

    name: str
    seeds: tuple[bytes, ...]
    """Valid files that mutations start from."""
    words: tuple[bytes, ...]
    """Bytes that a mutation may insert."""
    read: Callable[[Path, bytes], None]
    """Write the bytes into a folder and read them."""


def read_or_refused(read: Callable[[], object]) -> None:
    """Read; accept an error with a message of reasonable length."""
    try:
        read()
    except (ValueError, OSError) as error:
        message = str(error)
        if not message or len(message) > 2000:
            raise AssertionError(f"no readable message: {message[:200]!r}") from error


def _read_clip(path: Path) -> None:
    def read() -> None:
        clip = open_clip(path, fps=1500.0)
        for k in {0, len(clip) // 2, len(clip) - 1}:
            clip.frame(k)

    read_or_refused(read)


def _cih(folder: Path, content: bytes) -> None:
    (folder / "a.cih").write_bytes(content)
    (folder / "a.mraw").write_bytes(bytes(500))
    _read_clip(folder / "a.cih")


def _cihx(folder: Path, content: bytes) -> None:
    (folder / "b.cihx").write_bytes(content)
    (folder / "b.mraw").write_bytes(bytes(500))
    _read_clip(folder / "b.cihx")


def _cine(folder: Path, content: bytes) -> None:
    (folder / "c.cine").write_bytes(content)
    _read_clip(folder / "c.cine")


def _tiff(folder: Path, content: bytes) -> None:
    (folder / "d.tif").write_bytes(content)
    _read_clip(folder / "d.tif")


def _scene(folder: Path, content: bytes) -> None:
    for name in ("clip.avi", "background.png"):
        if not (folder / name).exists():
            (folder / name).write_bytes(b"")
    (folder / "scene.toml").write_bytes(content)
    read_or_refused(lambda: read_scene(folder / "scene.toml"))


def _plan(folder: Path, content: bytes) -> None:
    (folder / "throw.toml").write_bytes(content)
    read_or_refused(lambda: read_plan(folder / "throw.toml"))


def _track(folder: Path, content: bytes) -> None:
    (folder / "track.csv").write_bytes(content)
    (folder / "track_covariance.npy").unlink(missing_ok=True)
    read_or_refused(lambda: read_track(folder / "track.csv"))


def _covariance(track: bytes, folder: Path, content: bytes) -> None:
    (folder / "other.csv").write_bytes(track)
    (folder / "other_covariance.npy").write_bytes(content)
    read_or_refused(lambda: read_track(folder / "other.csv"))


def _bounces(folder: Path, content: bytes) -> None:
    (folder / "bounces.csv").write_bytes(content)
    read_or_refused(lambda: read_bounces(folder / "bounces.csv"))


def _fit(folder: Path, content: bytes) -> None:
    (folder / "fit.json").write_bytes(content)
    read_or_refused(lambda: read_parameters(folder / "fit.json"))


def targets(folder: Path) -> tuple[Target, ...]:
    """All targets; their seeds are written into `folder` once."""
    tiff = [
        write_tiff(folder / "s.tif", FRAMES).read_bytes(),
        write_tiff(folder / "z.tif", FRAMES[:1], compression="zlib").read_bytes(),
    ]
    cine = [write_cine(folder / f"s{bits}.cine", FRAMES, stored_bits=bits).read_bytes() for bits in (8, 10, 12, 16)]
    cih = write_photron(folder / "s.cih", FRAMES, stored_bits=12).read_bytes()
    cihx = write_photron(folder / "s.cihx", FRAMES, stored_bits=16).read_bytes()
    track, covariance = _track_files(folder)
    scenes = [
        path.read_bytes().replace(b"clip.mp4", b"clip.avi").replace(b"clip.cihx", b"clip.avi")
        for path in sorted(SAMPLES.glob("*/scene.toml"))
    ]
    plans = [path.read_bytes() for path in sorted((SAMPLES / "throws").glob("*.toml"))]
    fit = b'{"parameters": {"chi": {"value": 0.5, "low": 0.4, "high": 0.6, "level": 0.95, "free": true, "at_bound": false}}}'
    numbers = (
        b"0",
        b"-1",
        b"1e308",
        b"nan",
        b"inf",
        b"1e-320",
        b"9" * 25,
        b"4294967295",
        b"",
        b"0.5",
        b"1e999999999",
        b"1/0",
    )
    toml = (
        *numbers,
        b"[[camera]]",
        b"[start]\nframe = 3\n",
        b"true",
        b'"../x"',
        b"[" * 200,
        b"{",
        b"[[0, 99999999999]]",
        b"\n",
        b'"',
        b"frames = ",
    )
    binary = tuple(struct.pack("<I", n) for n in (0, 1, 8, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**20)) + tuple(
        struct.pack("<Q", n) for n in (0, 2**32, 2**63 - 1, 2**64 - 1)
    )
    return (
        Target("cih", (cih,), (*numbers, b" : ", b"\n", b"Raw", b"\xff\xfe", b"\xc2\xb2"), _cih),
        Target("cihx", (cihx,), (*numbers, b"<cih>", b"</cih>", b"<!DOCTYPE a [", b"&a;", b"<bit>", b"<" * 100), _cihx),
        Target("cine", tuple(cine), binary, _cine),
        Target("tiff", tuple(tiff), binary, _tiff),
        Target("scene", tuple(scenes), toml, _scene),
        Target("throw", tuple(plans), toml, _plan),
        Target("track", (track,), (*numbers, b",", b"\n", b"tracked", b'"', b"\0", b"," * 500), _track),
        Target(
            "covariance",
            (covariance,),
            (*numbers, b"'|O'", b"'<f8'", b"(1099511627776, 6, 6)", b"True", b"(" * 200),
            partial(_covariance, track),
        ),
        Target("bounces", (_BOUNCES,), (*numbers, b",", b"vertex", b'"'), _bounces),
        Target("fit", (fit,), (*numbers, b"null", b"NaN", b"[" * 500, b'"mu"', b"{}"), _fit),
    )


_BOUNCES = (
    b"bounce,t_s,sigma_t_s,contact,vertices,x_m,y_m,normal_velocity_before_m_s,normal_velocity_after_m_s,chi,chi_low,chi_high,"
    b"energy_before_J,energy_after_J,lowest_face_before,lowest_face_after\n"
    b"1,0.01,1e-06,vertex,3,0.0,0.0,-1.5,0.7,0.5,0.4,0.6,0.01,0.005,1,2\n"
)


def _track_files(folder: Path) -> tuple[bytes, bytes]:
    """A track of three frames, and its covariances."""
    start = State(0.0, np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    poses = np.tile(start.position_m, (3, 1)), np.tile(start.quaternion, (3, 1))
    track = Track(
        np.arange(3), np.arange(3) / 1500.0, *poses, np.tile(np.eye(6) * 1e-8, (3, 1, 1)), np.full(3, TRACKED)
    )
    write_track(folder / "s.csv", track)
    return (folder / "s.csv").read_bytes(), (folder / "s_covariance.npy").read_bytes()


def mutated(target: Target, random: np.random.Generator) -> bytes:
    """A seed of the target with one to eight changes, most of them in its header."""
    content = bytearray(target.seeds[random.integers(len(target.seeds))])
    for _ in range(random.integers(1, 9)):
        _change(content, target.words, random)
    return bytes(content)


def _place(content: bytearray, random: np.random.Generator) -> int:
    """A place to change: in the first bytes, at one that is not zero, or anywhere."""
    size, kind = len(content), random.integers(3)
    if not size:
        return 0
    if kind == 0:
        return int(random.integers(min(size, 128)))
    place = int(random.integers(size))
    if kind == 1:
        nonzero = np.flatnonzero(np.frombuffer(bytes(content[: 2**13]), np.uint8))
        return int(random.choice(nonzero)) if len(nonzero) else place
    return place


def _change(content: bytearray, words: tuple[bytes, ...], random: np.random.Generator) -> None:
    """Flip a bit, set or copy bytes, delete some, or insert a word."""
    size = len(content)
    place = _place(content, random)
    kind = random.integers(7)
    if kind == 0 and size:
        content[place] ^= 1 << int(random.integers(8))
    elif kind == 1 and size:
        content[place] = int(random.integers(256))
    elif kind == 2:
        word = words[random.integers(len(words))]
        content[place : place + len(word)] = word
    elif kind == 3:
        content[place:place] = words[random.integers(len(words))]
    elif kind == 4:
        del content[place : place + int(random.integers(1, 17))]
    elif kind == 5:
        other = int(random.integers(size)) if size else 0
        content[place:place] = content[other : other + int(random.integers(1, 33))]
    elif random.random() < 0.2:
        del content[place:]
