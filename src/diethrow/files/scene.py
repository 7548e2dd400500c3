"""The scene file: the footage, its cameras, the table and the die.

`read_scene` checks everything once and returns frozen values of the stages. A die and a table are required here. Footage and
cameras are required by the commands that need them (`Scene.views`): a fit to somebody else's track needs neither.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from ..model.die import Die
from ..model.errors import InputError
from ..model.world import GRAVITY_M_S2
from ..tracking.calibration import INTRINSICS, JOINT
from ..tracking.camera import Camera
from ..tracking.clip_parameters import CornerRounding
from ..tracking.footage import EXPONENTS, MAX_PIXELS, NAMED_RESPONSES, Response
from ..tracking.pose import FEWEST_CLICKS, Click, ManualInitialisation
from ..tracking.throw import (
    CAMERA_ERRORS,
    CENTRE_SIGMA_PX,
    CLOCK_SHARE,
    EDGE_SHARE,
    FOCAL_SHARE,
    PLACE_SIGMA_M,
    TURN_SIGMA_RAD,
    CalibrationErrors,
    usual_covariance,
)
from .csv_and_json import read_json
from .die_and_table import ESTIMATE, DieTable, Table, TableTable, WorldTable, die_from, table_from
from .settings import (
    FilesBeside,
    Matrix3,
    NotNegative,
    NotNegativeInt,
    Positive,
    PositiveInt,
    SceneError,
    TomlTable,
    Vector2i,
    Vector3,
    Vector4,
    Vector5,
    read_toml,
    refuse,
    tables_of,
    unit_guess,
    validate,
)

__all__ = ["ClipSource", "Scene", "SceneError", "View", "read_scene"]

Array = NDArray[np.float64]

MAX_DISTANCE_M = 100.0
"""From the world's origin to a camera; beyond it the translation is in another unit."""
ROTATION_TOLERANCE = 1e-4
"""Matrices and quaternions written with four decimals pass, and are replaced by the nearest rotation."""
EXACT_ROTATION = 1e-12
"""A matrix this near a rotation is used as it stands: the nearest rotation would only change its last digits."""
EXACT = "exact"
"""Instead of a calibration's file: cameras of rendered clips."""
SAME_NUMBER = 1e-6
"""Relative difference, and metres, up to which a scene and a calibration state the same: numbers may be rounded."""
SMALL_RADIUS_SHARE = 0.01
"""Radius of the corners, in inscribed radii, with which it is tried whether a solid can be rounded."""
LARGEST_EDGE_SHARE = 0.1
"""Of an edge, as its standard error; a larger one is in another unit."""
LARGEST_FPS_SHARE = 0.1
"""Of the recording rate, as its standard error; a larger one is in another unit."""


@dataclass(frozen=True)
class ClipSource:
    """The files of the footage and how it was recorded."""

    path: Path | None
    """A film, a folder or pattern of images, or a Photron header; None where the scene has no footage."""
    fps: float | None
    """Recording rate [1/s]; None where the clip's own file has it."""
    exposure_s: float | None
    background_path: Path | None
    """A frame without the die."""
    frame_range: tuple[int, int] | None
    """First frame, and the one after the last; None for the whole clip."""
    excluded: tuple[tuple[int, int], ...] = ()
    """Frames that are not used: ranges of a first frame and the one after the last."""
    response: Response = None
    """How grey levels follow light."""
    readout_s: float = 0.0
    """Time from the first row's mid-exposure to the last row's (rolling shutter); 0 for a global shutter. The time of a
    frame is that of its middle row."""
    fps_sigma: float | None = None
    """Standard error of the recording rate [1/s]; None for that of a quartz."""


@dataclass(frozen=True)
class View:
    """One camera and what it filmed."""

    camera: Camera
    path: Path | None
    background_path: Path | None
    calibration: Array | None
    """(15, 15) covariance of the camera's parameters, in the order of `tracking.throw.CAMERA_ERRORS`; None where the scene says
    nothing."""
    calibration_path: Path | None
    """The file that it was read from."""


@dataclass(frozen=True)
class Scene:
    """One filmed throw, as its scene file describes it."""

    path: Path
    text: str
    """The file as it was read."""
    clip: ClipSource
    cameras: tuple[View, ...]
    die: Die
    table: Table
    start: ManualInitialisation | None = None
    """The manual initial pose; None where it is searched for."""
    rounding: CornerRounding = CornerRounding.GIVEN
    """How the radius of the die's corners is found. Where the file does not give it, it is 0 in `die`."""
    edge_sigma_m: float | None = None
    """Standard error of the die's edge; None where the scene says nothing."""
    mesh_path: Path | None = None
    """The file of the die's mesh."""
    title: str | None = None
    """Of reports and recordings; None where the scene gives none."""

    @property
    def name(self) -> str:
        """The title, or else the name of the scene's folder."""
        return self.title or self.path.resolve().parent.name

    @property
    def settings_paths(self) -> tuple[Path, ...]:
        """The scene file, and the mesh of its die."""
        return (self.path,) if self.mesh_path is None else (self.path, self.mesh_path)

    def known_errors(self, interval_s: float | None) -> CalibrationErrors:
        """How well cameras, die and clock are known, with frames so far apart; None for a single frame, which has no rate. Where
        the scene says nothing: as a careful laboratory knows them."""
        edge_share = EDGE_SHARE if self.edge_sigma_m is None else self.edge_sigma_m / self.die.solid.edge_m
        clock_share = CLOCK_SHARE if self.clip.fps_sigma is None else self.clip.fps_sigma * (interval_s or 0.0)
        covariances = [
            usual_covariance(view.camera) if view.calibration is None else view.calibration for view in self.cameras
        ]
        cameras = tuple(view.camera for view in self.cameras)
        return CalibrationErrors(cameras, tuple(covariances), edge_share, clock_share)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is assumed of cameras and die because the file does not say how well they are known, in one sentence."""
        camera = (
            f"the focal length is known to {100.0 * FOCAL_SHARE:g} %, the principal point to {CENTRE_SIGMA_PX:g} px, the "
            f"camera's pose to {np.degrees(TURN_SIGMA_RAD):g} degrees and {1e3 * PLACE_SIGMA_M:g} mm (camera.calibration)"
        )
        assumed = [camera] if any(view.calibration is None for view in self.cameras) else []
        assumed += [] if self.edge_sigma_m is not None else [f"the edge to {100.0 * EDGE_SHARE:g} % (die.edge_sigma_m)"]
        return (f"Assumed, since the scene does not say it: {', and '.join(assumed)}.",) if assumed else ()

    def known_exactly(self) -> Scene:
        """The scene with cameras, edge and frame rate known exactly, as those of a rendered clip are."""
        exact = np.zeros((CAMERA_ERRORS, CAMERA_ERRORS))
        views = tuple(replace(view, calibration=exact, calibration_path=None) for view in self.cameras)
        return replace(self, cameras=views, clip=replace(self.clip, fps_sigma=0.0), edge_sigma_m=0.0)

    def views(self) -> tuple[View, ...]:
        """The cameras with their footage; initial poses and the replay use the first one. Raises SceneError where there is no
        camera, or one has no footage."""
        if not self.cameras:
            raise SceneError(
                f"{self.path}: camera is missing; wanted a [camera] table, since tracking needs a calibrated camera"
            )
        for k, view in enumerate(self.cameras):
            if view.path is None:
                key = "clip.path" if len(self.cameras) == 1 else f"camera[{k + 1}].path"
                raise SceneError(f"{self.path}: {key} is missing; wanted {PATH_WANTED}")
        return self.cameras

    def given_die(self) -> Die:
        """The die, for commands without pictures. Raises SceneError where the radius is to be estimated from them."""
        if self.rounding is CornerRounding.ESTIMATED:
            wanted = (
                "a track does not show the corners; wanted their radius in metres, as tracking reported it or measured"
            )
            raise refuse(self.path, "die.corner_radius_m", ESTIMATE, wanted)
        return self.die

    def still_table(self) -> Table:
        """The table, at rest. Raises SceneError for one that moves: tracking and joint fits have no model of it."""
        motion = self.table.motion
        if motion is not None and motion.amplitude_m > 0:
            wanted = "an oscillating table can be fitted to a single track (diethrow fit) but not tracked; wanted 0"
            raise refuse(self.path, "table.motion.amplitude_m", motion.amplitude_m, wanted)
        return self.table


def read_scene(path: Path, *, allow_outside: bool = False) -> Scene:
    """The scene in a TOML file. Raises SceneError, one sentence a mistake.

    Paths in the file are relative to it. They may lead out of its folder only with `allow_outside`: a scene may come from
    somebody else.
    """
    path = Path(path)
    data, text = read_toml(path)
    return _scene(data, text, FilesBeside(path, allow_outside))


def recorded_scene(text: str, path: Path) -> Scene:
    """The scene that a result was made from, by the text in its provenance; clip and pictures may be gone since.

    Raises SceneError as `read_scene`, also for a mesh or a calibration that is gone."""
    return _scene(tables_of(text, path), text, FilesBeside(path, allow_outside=True, may_be_gone=True))


def _scene(data: dict[str, Any], text: str, files: FilesBeside) -> Scene:
    path = files.settings_path
    if isinstance(data.get("camera"), dict):
        data["camera"] = [data["camera"]]
    checked = validate(_SceneFile, data, path)
    clip = _clip(checked.clip, path, files)
    several = len(checked.camera) > 1
    views = tuple(
        _view(table, f"camera[{k + 1}]" if several else "camera", clip, path, files)
        for k, table in enumerate(checked.camera)
    )
    die, mesh = die_from(checked.die, path, files)
    start = _start(checked.start, clip, views, die, path) if checked.start is not None else None
    table = table_from(checked.table, checked.world)
    edge_sigma_m = _edge_sigma_m(checked.die, die, path)
    rounding = _rounding(checked.die, die, path)
    return Scene(path, text, clip, views, die, table, start, rounding, edge_sigma_m, mesh, checked.title)


# --- the file, as TOML tables ---

PATH_WANTED = "the path of the footage, relative to the scene file"


def _known_response(value: float | str) -> float | str:
    if isinstance(value, str) and value not in NAMED_RESPONSES:
        raise InputError("no such word")
    if not isinstance(value, str) and not EXPONENTS[0] <= value <= EXPONENTS[1]:
        raise InputError("out of range")
    return value


def _rising(value: list[int]) -> list[int]:
    if not 0 <= value[0] < value[1]:
        raise InputError("not rising")
    return value


def _unit_length(value: list[float]) -> list[float]:
    if abs(float(np.linalg.norm(value)) - 1.0) > ROTATION_TOLERANCE:
        raise InputError("not of length 1")
    return value


def _pair(value: list[float]) -> list[float]:
    if len(value) != 2:
        raise InputError("not two numbers")
    return value


def _not_empty(value: str) -> str:
    if not value.strip() or "\0" in value:
        raise InputError("empty")
    return value


ResponseOrName = Annotated[float | str, AfterValidator(_known_response)]
UnitQuaternion = Annotated[Vector4, AfterValidator(_unit_length)]
NonEmptyText = Annotated[str, AfterValidator(_not_empty)]

_BACKGROUND_WANTED = "the path of a picture of the scene without the die, relative to the scene file"


class _ClipTable(TomlTable):
    path: NonEmptyText | None = Field(None, description=PATH_WANTED)
    fps: Positive | None = Field(None, description="the recording rate in frames per second, a number above 0")
    exposure_s: Positive | None = Field(None, description="the exposure time of a frame in seconds, a number above 0")
    readout_s: NotNegative = Field(
        0.0,
        description="the time in seconds from the first row's mid-exposure to the last row's (rolling shutter), 0 or more",
    )
    fps_sigma: NotNegative | None = Field(
        None, description="the standard error of fps in frames per second, 0 or more; left out: 1e-5 of fps"
    )
    background: NonEmptyText | None = Field(None, description=_BACKGROUND_WANTED)
    frames: Annotated[Vector2i, AfterValidator(_rising)] | None = Field(
        None, description="[first, stop], two whole numbers with 0 <= first < stop"
    )
    exclude: list[NotNegativeInt | Annotated[Vector2i, AfterValidator(_rising)]] = Field(
        [],
        description="a list of frame numbers and of ranges [first, stop] with 0 <= first < stop, as in [[120, 131], 200]; "
        "their pictures are not used",
    )
    response: ResponseOrName | None = Field(
        None,
        description=f'"linear", "srgb", or the exponent of grey = light ** exponent, {EXPONENTS[0]} to {EXPONENTS[1]}',
    )


class _CameraTable(TomlTable):
    width: PositiveInt = Field(description="the width of a frame in pixels, a whole number above 0")
    height: PositiveInt = Field(description="the height of a frame in pixels, a whole number above 0")
    matrix: Matrix3 = Field(description="3 rows of 3 numbers, [[fx, s, cx], [0, fy, cy], [0, 0, 1]] in pixels")
    distortion: Vector5 = Field([0.0] * 5, description="5 numbers, k1 k2 p1 p2 k3")
    rotation: Matrix3 = Field(description="3 rows of 3 numbers, the rotation from world to camera")
    translation_m: Vector3 = Field(description="3 numbers in metres, x_cam = rotation X_world + translation_m")
    calibration: NonEmptyText | None = Field(
        None, description=f'"{EXACT}", or the path of a calibration.json relative to the scene file'
    )
    path: NonEmptyText | None = Field(None, description=PATH_WANTED)
    background: NonEmptyText | None = Field(None, description=_BACKGROUND_WANTED)


class _DieTable(DieTable):
    edge_sigma_m: NotNegative | None = Field(
        None,
        description="the standard error of edge_m, or of the mean edge, in metres, 0 or more; left out: 0.1 % of it",
    )


class _ClickTable(TomlTable):
    px: Annotated[list[float], AfterValidator(_pair)] = Field(description="[x, y], where the corner is seen, in pixels")
    vertex: NotNegativeInt | None = Field(None, description="the corner's number in vertices.csv, or no such key")


class _StartTable(TomlTable):
    frame: NotNegativeInt = Field(description="the number of the frame in the file, as in track.csv, 0 or more")
    position_m: Vector3 | None = Field(None, description="3 numbers in metres, the die's centre in the world")
    quaternion_wxyz: UnitQuaternion | None = Field(
        None, description="4 numbers of length 1, w x y z, from body to world"
    )
    corners: list[_ClickTable] = Field(
        [], description="4 or more clicks, [{vertex = 0, px = [x, y]}, ...], all with their vertex or none"
    )


class _SceneFile(TomlTable):
    title: NonEmptyText | None = Field(None, description="the title of the throw in reports and recordings, a text")
    clip: _ClipTable = Field(description="a [clip] table with path and fps")
    camera: list[_CameraTable] = Field([], description="a [camera] table, or several [[camera]] tables")
    table: TableTable = Field(description='a [table] table, for example surface = "wood"')
    die: _DieTable = Field(description="a [die] table with shape, its lengths (edge_m) and mass_kg")
    start: _StartTable | None = Field(None, description="a [start] table with frame, and a pose or corners")
    world: WorldTable = Field(WorldTable(gravity_m_s2=GRAVITY_M_S2), description="a [world] table with gravity_m_s2")


# --- from tables to values ---


def _clip(table: _ClipTable, path: Path, files: FilesBeside) -> ClipSource:
    frame_s = 1.0 / table.fps if table.fps else np.inf
    if table.exposure_s and table.exposure_s > frame_s:
        guess = unit_guess(table.exposure_s, (1e-3, 1e-6), lambda exposure: exposure <= frame_s)
        wanted = f"wanted seconds, at most the {frame_s:.4g} s between two frames{guess}"
        raise refuse(path, "clip.exposure_s", table.exposure_s, wanted)
    if table.readout_s > frame_s:
        guess = unit_guess(table.readout_s, (1e-3, 1e-6), lambda readout: readout <= frame_s)
        wanted = f"wanted seconds, at most the {frame_s:.4g} s between two frames{guess}"
        raise refuse(path, "clip.readout_s", table.readout_s, wanted)
    return ClipSource(
        files.existing(table.path, "clip.path", PATH_WANTED),
        table.fps,
        table.exposure_s,
        files.existing(table.background, "clip.background", _BACKGROUND_WANTED),
        (table.frames[0], table.frames[1]) if table.frames else None,
        tuple((part, part + 1) if isinstance(part, int) else (part[0], part[1]) for part in table.exclude),
        table.response,
        table.readout_s,
        _fps_sigma(table, path),
    )


def _edge_sigma_m(table: _DieTable, die: Die, path: Path) -> float | None:
    """The standard error of the edge. Raises SceneError for one that says nothing of it."""
    edge_m = die.solid.edge_m
    most_m = LARGEST_EDGE_SHARE * edge_m
    if table.edge_sigma_m is not None and table.edge_sigma_m > most_m:
        guess = unit_guess(table.edge_sigma_m, (1e-3, 1e-6), lambda sigma: sigma <= most_m)
        wanted = f"wanted metres, at most a tenth of edge_m = {edge_m:g}{guess}"
        raise refuse(path, "die.edge_sigma_m", table.edge_sigma_m, wanted)
    return table.edge_sigma_m


def _fps_sigma(table: _ClipTable, path: Path) -> float | None:
    """The standard error of the rate. Raises SceneError for one that says nothing of it."""
    if table.fps_sigma is not None and table.fps and table.fps_sigma > LARGEST_FPS_SHARE * table.fps:
        wanted = f"wanted frames per second, at most a tenth of fps = {table.fps:g}"
        raise refuse(path, "clip.fps_sigma", table.fps_sigma, wanted)
    return table.fps_sigma


def _start(table: _StartTable, clip: ClipSource, views: tuple[View, ...], die: Die, path: Path) -> ManualInitialisation:
    """The manual initial pose. Raises SceneError for one that is incomplete or impossible."""
    first, stop = clip.frame_range or (0, np.inf)
    if not first <= table.frame < stop or any(a <= table.frame < b for a, b in clip.excluded):
        raise refuse(
            path, "start.frame", table.frame, "wanted a frame within clip.frames that clip.exclude does not name"
        )
    has_pose = table.position_m is not None and table.quaternion_wxyz is not None
    if has_pose == bool(table.corners) or (table.position_m is None) != (table.quaternion_wxyz is None):
        given = [key for key in ("position_m", "quaternion_wxyz", "corners") if getattr(table, key)]
        raise refuse(path, "start", given, "wanted either position_m and quaternion_wxyz, or corners")
    if table.position_m is not None and not 0 < table.position_m[2] <= MAX_DISTANCE_M:
        raise refuse(path, "start.position_m", table.position_m, "wanted metres, above the table (z = 0)")
    clicks = tuple(Click(np.array(each.px, float), each.vertex) for each in table.corners)
    if clicks:
        _check_clicks(clicks, views, die, path)
    if not has_pose:
        return ManualInitialisation(table.frame, clicks=clicks)
    quaternion = np.array(table.quaternion_wxyz, float)
    return ManualInitialisation(table.frame, np.array(table.position_m, float), quaternion / np.linalg.norm(quaternion))


def _check_clicks(clicks: tuple[Click, ...], views: tuple[View, ...], die: Die, path: Path) -> None:
    """Raise SceneError unless there are enough clicks, inside the picture, on different corners of the die."""
    if len(clicks) < FEWEST_CLICKS:
        raise refuse(path, "start.corners", f"{len(clicks)} clicks", f"wanted {FEWEST_CLICKS} or more")
    vertices = [click.vertex for click in clicks if click.vertex is not None]
    count = len(die.solid.vertices)
    if vertices and (len(vertices) < len(clicks) or len(set(vertices)) < len(clicks) or max(vertices) >= count):
        wanted = f"wanted different numbers from 0 to {count - 1}, one for each click, or none at all"
        raise refuse(path, "start.corners.vertex", vertices, wanted)
    size = (views[0].camera.width_px, views[0].camera.height_px) if views else (np.inf, np.inf)
    for click in clicks:
        if not (-0.5 <= click.px[0] < size[0] and -0.5 <= click.px[1] < size[1]):
            raise refuse(path, "start.corners.px", click.px, "wanted a place inside the picture, [x, y] in pixels")


def _check_picture(table: _CameraTable, key: str, path: Path) -> None:
    """Raise SceneError for a picture that no camera takes, before memory is taken for it."""
    if table.width * table.height > MAX_PIXELS:
        size = [table.width, table.height]
        raise refuse(path, f"{key}.width and {key}.height", size, f"wanted {MAX_PIXELS} pixels at most")


def _view(table: _CameraTable, key: str, clip: ClipSource, path: Path, files: FilesBeside) -> View:
    _check_picture(table, key, path)
    matrix = np.array(table.matrix, float)
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and matrix[1, 0] == 0 and (matrix[2] == (0.0, 0.0, 1.0)).all()):
        wanted = "wanted [[fx, s, cx], [0, fy, cy], [0, 0, 1]] in pixels, with fx and fy above 0"
        raise refuse(path, f"{key}.matrix", matrix, wanted)
    translation = np.array(table.translation_m, float)
    camera = Camera(
        table.width, table.height, matrix, np.array(table.distortion, float), _rotation(table, key, path), translation
    )
    _check_camera_pose(camera, key, path)
    own_background = files.existing(table.background, f"{key}.background", _BACKGROUND_WANTED)
    return View(
        camera,
        files.existing(table.path, f"{key}.path", PATH_WANTED) or clip.path,
        own_background or clip.background_path,
        *_calibration(table.calibration, camera, key, path, files),
    )


def _calibration(
    given: str | None, camera: Camera, key: str, path: Path, files: FilesBeside
) -> tuple[Array | None, Path | None]:
    """The covariance of a camera's parameters, and the file that it is from. Raises SceneError for a file that is none, or of
    another camera."""
    if given is None:
        return None, None
    if given == EXACT:
        return np.zeros((CAMERA_ERRORS, CAMERA_ERRORS)), None
    wanted = "the path of the calibration.json that diethrow calibrate wrote, relative to the scene file"
    file = files.existing(given, f"{key}.calibration", wanted)
    assert file is not None
    try:
        return _stated_covariance(file, camera), file
    except ValueError as error:
        raise refuse(path, f"{key}.calibration", given, f'{error}; wanted {wanted}, or "{EXACT}"') from error


def _stated_covariance(file: Path, camera: Camera) -> Array:
    """(15, 15) covariance of a camera's parameters in a `calibration.json`; a pose that it does not hold is as usual. Raises
    ValueError for a file that holds none, or is of another camera."""
    try:
        record = read_json(file)
        names = [JOINT.index(name) for name in record["covariance_names"]]
        stated = np.array(record["covariance"], float)
        values = np.array([record["intrinsics"][name]["value"] for name in INTRINSICS], float)
        table = record["table"]
        pose = None if table is None else (np.array(table["rotation"], float), np.array(table["translation_m"], float))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file.name} is no record of a calibration ({type(error).__name__}: {error})") from error
    covariance = np.zeros((len(JOINT), len(JOINT)))
    if stated.shape != (len(names), len(names)) or not np.isfinite(stated).all():
        raise InputError(f"{file.name} has a covariance of shape {stated.shape} for {len(names)} numbers")
    if (np.diag(stated) < 0.0).any():
        raise InputError(f"{file.name} has a variance below 0")
    covariance[np.ix_(names, names)] = stated
    K = camera.matrix
    own = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *camera.distortion])
    if not np.allclose(values, own, rtol=SAME_NUMBER, atol=SAME_NUMBER):
        raise InputError(f"{file.name} is of a camera with another matrix or distortion")
    found = covariance[:CAMERA_ERRORS, :CAMERA_ERRORS]
    if pose is None:
        pose_errors = slice(len(INTRINSICS), CAMERA_ERRORS)
        found[pose_errors, pose_errors] = usual_covariance(camera)[pose_errors, pose_errors]
    elif not (
        np.allclose(pose[0], camera.rotation, atol=ROTATION_TOLERANCE)
        and np.allclose(pose[1], camera.translation_m, atol=SAME_NUMBER)
    ):
        raise InputError(f"{file.name} is of a camera at another place")
    return found


def _rotation(table: _CameraTable, key: str, path: Path) -> Array:
    rotation = np.array(table.rotation, float)
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if error > ROTATION_TOLERANCE:
        wanted = f"wanted a rotation, rows of length 1 at right angles; R Rᵀ is {error:.2g} away from the identity"
        raise refuse(path, f"{key}.rotation", rotation, wanted)
    if np.linalg.det(rotation) < 0:
        wanted = "wanted a rotation, this is a reflection (determinant -1); try the sign of one row"
        raise refuse(path, f"{key}.rotation", rotation, wanted)
    if error < EXACT_ROTATION:
        return rotation
    u, _, vt = np.linalg.svd(rotation)
    return np.asarray(u @ vt)


def _check_camera_pose(camera: Camera, key: str, path: Path) -> None:
    """Raise SceneError for a camera that is below the table, too far from it, or turned away from it."""
    translation = camera.translation_m
    if float(np.linalg.norm(translation)) > MAX_DISTANCE_M:
        guess = f"; did you mean {shown_list(translation * 1e-3)}?"
        raise refuse(
            path, f"{key}.translation_m", translation, f"wanted metres, at most {MAX_DISTANCE_M:g} m away{guess}"
        )
    height = float(camera.centre_m[2])
    if height <= 0:
        wanted = f"the camera is {-height:.4g} m below the table (z = 0); wanted a camera above it"
        if translation[2] > 0:
            wanted += ", with rotation and translation_m from world to camera"
        raise refuse(path, f"{key}.translation_m", translation, wanted)
    if not _sees_table(camera):
        wanted = "no pixel of the camera shows the table (z = 0); wanted a camera turned to it, rotation from world to camera"
        raise refuse(path, f"{key}.rotation", camera.rotation, wanted)


def _sees_table(camera: Camera) -> bool:
    """Whether the ray of a corner of the frame points down. The lowest ray is always one of these, distortion aside."""
    corners = [(x, y, 1.0) for x in (0.0, camera.width_px - 1.0) for y in (0.0, camera.height_px - 1.0)]
    rays = np.linalg.solve(camera.matrix, np.array(corners).T).T @ camera.rotation
    return bool((rays[:, 2] < 0).any())


def _rounding(table: DieTable, die: Die, path: Path) -> CornerRounding:
    """How the radius of the corners is found for a `[die]` table. Raises SceneError where it is to be estimated of a solid that
    cannot be rounded by one radius."""
    if not isinstance(table.corner_radius_m, float):
        try:
            die.with_corner_radius(SMALL_RADIUS_SHARE * die.solid.inradius)
        except ValueError as error:
            if table.corner_radius_m == ESTIMATE:
                raise refuse(path, "die.corner_radius_m", ESTIMATE, f"{error}; wanted no such key") from error
            return CornerRounding.GIVEN
    if table.corner_radius_m is None:
        return CornerRounding.TESTED
    return CornerRounding.ESTIMATED if table.corner_radius_m == ESTIMATE else CornerRounding.GIVEN


def shown_list(values: Array) -> str:
    """`[0.003, 0.021, 0.616]`."""
    return "[" + ", ".join(f"{value:.6g}" for value in values) + "]"
