"""`diethrow new`: a scene file from a folder with a clip, pictures of a board, and a caliper.

The files are recognised by their content and their names; what the camera wrote is read; what only a person knows is asked. With
pictures of a board the camera is calibrated. The scene is written with a comment for every line, checked, and its first
frame drawn with the die found in it. What is missing is named, with how to get it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ...files.outputs import OutputExistsError, whole_file
from ...files.scene import read_scene
from ...model.die import SHAPES, Solid
from ...model.errors import InputError
from ...replay.elements import Motion, motion_of
from ...replay.figures import edges_on_frame
from ...tracking.calibration import Board, make_board
from ...tracking.camera import Camera
from ...tracking.footage import Clip, open_clip
from .calibrate import calibrate_camera
from .check import Check, check_clip
from .footage import open_at_any_rate

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".tif", ".tiff", ".webp")
"""Endings of single pictures."""
BOARD_WORDS = re.compile(r"board|calib|chess|charuco|checker", re.IGNORECASE)
TABLE_WORDS = re.compile(r"table|floor|flat", re.IGNORECASE)
BACKGROUND_WORDS = re.compile(r"background|empty|without|bg", re.IGNORECASE)
FEWEST_FRAMES = 10
"""Of a film; a folder or a file of fewer pictures is none."""
CAMERA_FOLDER = "camera"

Role = Literal["clip", "board", "board on the table", "background", "calibration", "scene", "another film", "unknown"]


@dataclass(frozen=True)
class FoundFile:
    """One file or folder, and what it seems to be."""

    path: Path
    role: Role
    said: str
    """What was found in it, in a few words."""


@dataclass(frozen=True)
class ClipRead:
    """What a clip says of itself."""

    path: Path
    frames: int
    width_px: int
    height_px: int
    bit_depth: int
    rate_hz: float | None
    """Recording rate; None where the file has only a playback rate, or none."""
    exposure_s: float | None


@dataclass(frozen=True)
class Answers:
    """What only a person knows; None where it was not said."""

    shape: str = "cube"
    edge_mm: float | None = None
    mass_g: float | None = None
    fps: float | None = None
    exposure_s: float | None = None
    surface: str = "wood"
    board: Literal["charuco", "chessboard"] = "charuco"
    squares: tuple[int, int] = (7, 5)
    square_mm: float | None = None
    marker_mm: float | None = None
    dictionary: str = "DICT_4X4_50"


@dataclass(frozen=True, eq=False)
class NewScene:
    """The scene file of a folder."""

    path: Path
    files: tuple[FoundFile, ...]
    missing: tuple[str, ...]
    """What is missing, and how to get it, one sentence each; empty for a scene that runs."""
    notices: tuple[str, ...]
    check: Check | None
    """None where something is missing."""
    first_frame: Path | None
    """Picture of the first frame with the die found in it; None where no die was found."""


def look_through(folder: Path) -> tuple[FoundFile, ...]:
    """What the files of a folder seem to be. Of several films the longest is the clip. Raises InputError without a folder."""
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; wanted one with a clip in it")
    found = [role_of(path) for path in sorted(folder.iterdir()) if not path.name.startswith(".")]
    films = [one for one in found if one.role == "clip"]
    if len(films) > 1:
        longest = max(films, key=lambda one: len(open_at_any_rate(one.path)))
        found = [
            FoundFile(one.path, "another film", one.said) if one.role == "clip" and one != longest else one
            for one in found
        ]
    return tuple(found)


def read_clip_facts(path: Path) -> ClipRead:
    """What the clip says. Raises InputError or OSError for what is none."""
    clip = open_at_any_rate(path)
    facts = clip.metadata()
    rate, exposure = facts["record_rate_hz"], facts["exposure_s"]
    return ClipRead(path, len(clip), clip.width_px, clip.height_px, clip.bit_depth, rate, exposure)


def new_scene(
    folder: Path,
    answers: Answers,
    *,
    force: bool = False,
    progress: Callable[[str], None] = lambda sentence: None,
) -> NewScene:
    """Write `scene.toml` into a folder, and check it. Raises OutputExistsError for a scene that is there, unless `force`, and
    InputError for a folder without a clip, and for a shape that an edge does not describe."""
    if answers.shape not in SHAPES:
        raise InputError(
            f"shape = {answers.shape}: wanted {', '.join(SHAPES)}; for any other die write the [die] table by hand"
        )
    path = folder / "scene.toml"
    if path.exists() and not force:
        raise OutputExistsError(f"{path} exists; wanted a folder without a scene, or --force to replace it")
    files = look_through(folder)
    clips = [one.path for one in files if one.role == "clip"]
    if not clips:
        raise InputError(
            f"{folder}: no film is in it; wanted an AVI, MP4, TIFF, .cine, .cihx or .mraw, or a folder of pictures"
        )
    clip = read_clip_facts(clips[0])
    camera, notices = _camera(folder, files, answers, force, progress)
    missing = _missing(clip, answers, camera is not None)
    text = scene_text(folder, files, clip, answers, camera)
    with whole_file(path, force=force) as file:
        file.write_text(text, encoding="utf-8")
    if missing:
        return NewScene(path, files, missing, notices, None, None)
    progress("checking the clip")
    scene = read_scene(path)
    check = check_clip(scene)
    part = check.measured[0].tracked_part
    first_frame = None
    if part is not None and part.track.tracked.any():
        first_frame = folder / "first_frame.png"
        motion, view = motion_of("measured", part.track, part.throw), scene.views()[0]
        _draw(first_frame, open_clip(clip.path, fps=scene.clip.fps), view.camera, scene.die.solid, motion)
    return NewScene(path, files, (), notices, check, first_frame)


def scene_text(folder: Path, files: Sequence[FoundFile], clip: ClipRead, answers: Answers, camera: str | None) -> str:
    """The scene file, with a comment for every line."""
    background = next((one.path.name for one in files if one.role == "background"), None)
    exposure = answers.exposure_s if answers.exposure_s is not None else clip.exposure_s
    rate = answers.fps if answers.fps is not None else clip.rate_hz
    origin = "as the file says" if answers.fps is None and clip.rate_hz is not None else "as stated"
    lines = [
        f"# {folder.resolve().name}: {clip.frames} frames of {clip.width_px} x {clip.height_px} pixels, {clip.bit_depth} bit.",
        "",
        "[clip]",
        f"path = {toml_text(clip.path.name)}",
        _line("fps", rate, f"recording rate in frames per second, {origin}", "recording rate, not that of a player"),
        _line(
            "exposure_s", exposure, "time for which the shutter is open", "time for which the shutter is open, if known"
        ),
        f"background = {toml_text(background)}   # the scene without the die"
        if background
        else '# background = "background.png"   # a picture without the die; without it one is estimated from the clip',
        "",
        camera.rstrip() if camera is not None else "# [camera] is missing: see `diethrow calibrate`",
        "",
        "[table]",
        f'surface = {toml_text(answers.surface)}   # "mirror" where the table reflects the die',
        "",
        "[die]",
        f'shape = "{answers.shape}"',
        _line(
            "edge_m", _scaled(answers.edge_mm), "between corners, by caliper", "length of an edge in metres, by caliper"
        ),
        _line(
            "mass_kg", _scaled(answers.mass_g), "by a balance", "mass in kilograms; the landing does not depend on it"
        ),
        "# corner_radius_m = 0.001   # of rounded corners; left out: estimated from the clip",
        '# marks = "pips"   # "pips" or "numbers" on the faces, which tell them apart',
        "",
    ]
    return "\n".join(lines)


def role_of(path: Path) -> FoundFile:
    """What a file or a folder seems to be, by its name and its content."""
    name = path.name
    if name == "scene.toml":
        return FoundFile(path, "scene", "a scene file")
    if path.is_dir() and (path / "camera.toml").exists():
        return FoundFile(path, "calibration", "a calibration that diethrow calibrate wrote")
    if name == "camera.toml":
        return FoundFile(path, "calibration", "the [camera] table of a scene")
    if path.is_file() and path.suffix.lower() in PICTURES and BOARD_WORDS.search(path.stem):
        if TABLE_WORDS.search(path.stem):
            return FoundFile(path, "board on the table", "a picture of the board that lies on the table, by its name")
        return FoundFile(path, "board", "a picture of a board, by its name")
    if path.is_dir() and BOARD_WORDS.search(name):
        count = sum(each.suffix.lower() in PICTURES for each in path.iterdir())
        return FoundFile(path, "board", f"{count} pictures of a board, by its name")
    if path.is_file() and path.suffix.lower() in PICTURES and BACKGROUND_WORDS.search(path.stem):
        return FoundFile(path, "background", "the scene without the die, by its name")
    film = _film_or_unknown(path)
    if film.role == "clip" and path.is_file() and BOARD_WORDS.search(path.stem):
        lies = TABLE_WORDS.search(path.stem) is not None
        what = "a film of the board that lies on the table" if lies else "a film of the board"
        return FoundFile(path, "board on the table" if lies else "board", f"{what}, by its name: {film.said}")
    return film


def _film_or_unknown(path: Path) -> FoundFile:
    """Whether a file, or a folder of pictures, is a film."""
    if path.is_dir() and not any(each.suffix.lower() in PICTURES for each in path.iterdir()):
        return FoundFile(path, "unknown", "a folder without pictures")
    try:
        clip = open_at_any_rate(path)
        count = len(clip)
    except (ValueError, OSError):
        return FoundFile(path, "unknown", "no film and no picture that is recognised")
    if count < FEWEST_FRAMES:
        return FoundFile(path, "unknown", f"{count} pictures, too few for a film")
    return FoundFile(path, "clip", f"{count} frames of {clip.width_px} x {clip.height_px} pixels")


def _camera(
    folder: Path, files: Sequence[FoundFile], answers: Answers, force: bool, progress: Callable[[str], None]
) -> tuple[str | None, tuple[str, ...]]:
    """The [camera] table, from a calibration that is there or from pictures of the board; None without either."""
    done = next((one.path for one in files if one.role == "calibration"), None)
    if done is not None and not (force and _pictures(files) and answers.square_mm is not None):
        inside = done if done.is_dir() else done.parent
        return _with_errors(folder, inside), ()
    pictures = _pictures(files)
    if not pictures or answers.square_mm is None:
        return None, ()
    progress(f"calibrating from {len(pictures)} pictures of the board")
    table = next((one.path for one in files if one.role == "board on the table"), None)
    found = calibrate_camera(pictures, _board(answers), folder / CAMERA_FOLDER, table=table, force=force)
    return _with_errors(folder, folder / CAMERA_FOLDER), found.notices


def _with_errors(folder: Path, calibration: Path) -> str | None:
    """The [camera] table with the file of its errors; None where the pose over the table is missing."""
    text, record = (calibration / "camera.toml").read_text(encoding="utf-8"), calibration / "calibration.json"
    kept = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    if "translation_m" not in kept:
        return None
    if not record.exists():
        return kept
    return f'{kept}\ncalibration = "{record.relative_to(folder).as_posix()}"   # how well all this is known'


def _pictures(files: Sequence[FoundFile]) -> list[Path]:
    """The pictures of the board."""
    found: list[Path] = []
    for one in files:
        if one.role == "board":
            inside = (
                sorted(each for each in one.path.iterdir() if each.suffix.lower() in PICTURES)
                if one.path.is_dir()
                else []
            )
            found += inside or [one.path]
    return found


def _board(answers: Answers) -> Board:
    columns, rows = answers.squares
    marker_m = None if answers.marker_mm is None else 1e-3 * answers.marker_mm
    assert answers.square_mm is not None
    return make_board(answers.board, columns, rows, 1e-3 * answers.square_mm, marker_m, answers.dictionary, None)


def _missing(clip: ClipRead, answers: Answers, has_camera: bool) -> tuple[str, ...]:
    lacks = []
    if answers.fps is None and clip.rate_hz is None:
        lacks.append(f"fps: {clip.path.name} has no recording rate; read it off the camera's settings, and give --fps")
    if answers.edge_mm is None:
        lacks.append("edge_m: measure an edge of the die with a caliper, and give --edge-mm")
    if answers.mass_g is None:
        lacks.append(
            "mass_kg: weigh the die, or give any mass: --mass-g; energies are in proportion, motions do not change"
        )
    if not has_camera:
        lacks.append(
            "[camera]: photograph a ChArUco board or a chessboard some twenty times with the settings of the clip, once flat on "
            "the table, or film it; call that board_*.png and board_on_table.png, or board.mp4 and board_on_table.mp4, and give "
            "--square-mm; or run diethrow calibrate"
        )
    return tuple(lacks)


def toml_text(text: str) -> str:
    """A TOML string; what JSON escapes, TOML escapes in the same way."""
    return json.dumps(text, ensure_ascii=False)


def _line(key: str, value: float | None, comment: str, wanted: str) -> str:
    return f"# {key} =   # {wanted}" if value is None else f"{key} = {value:.10g}   # {comment}"


def _scaled(thousandths: float | None) -> float | None:
    """Millimetres as metres, or grams as kilograms."""
    return None if thousandths is None else 1e-3 * thousandths


def _draw(path: Path, clip: Clip, camera: Camera, solid: Solid, motion: Motion) -> None:
    """The first frame with a pose, and the edges of the die found in it."""
    from matplotlib.figure import Figure

    width = 6.0
    figure = Figure(figsize=(width, width * clip.height_px / clip.width_px), dpi=160)
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    edges_on_frame(ax, clip, camera, solid, [motion], int(motion.frame[0]))
    ax.set_axis_off()
    figure.savefig(path)
