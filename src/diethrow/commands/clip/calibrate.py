"""`diethrow calibrate`: the [camera] table of a scene from pictures of a board, with standard errors and a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...files.csv_and_json import write_json
from ...files.outputs import whole_folder
from ...files.provenance import Stopwatch, write_provenance
from ...model.errors import InputError
from ...replay.pages import calibration_page
from ...tracking.calibration import (
    INTRINSICS,
    JOINT,
    Board,
    BoardView,
    Calibration,
    TablePose,
    calibrate,
    eight_bits,
    find_boards,
    table_pose,
)
from ...tracking.footage import PICTURE_SUFFIXES, Frame, is_cine, is_photron, open_clip, read_picture
from .footage import open_at_any_rate

FILM_PICTURES = 24
"""Frames of a film of the board: about as many as one would photograph. More are nearly the same pictures again."""


@dataclass(frozen=True, eq=False)
class CameraFound:
    """Result of `calibrate_camera`, as written to `folder`."""

    folder: Path
    calibration: Calibration
    table: TablePose | None
    notices: tuple[str, ...]
    """One sentence each."""
    pictures: int
    """Pictures looked at, with those taken from films."""


def calibrate_camera(
    pictures: Sequence[Path],
    board: Board,
    out: Path,
    *,
    table: Path | None = None,
    thickness_m: float = 0.0,
    force: bool = False,
    command: tuple[str, ...] = (),
) -> CameraFound:
    """Calibrate the camera and, with a picture of the board on the table, its pose; write both to the folder `out`.

    A picture may also be a .cine or a Photron film, of which the first frame is used, or any other film, of which FILM_PICTURES
    frames are used; of one of the board on the table the first. Raises ValueError or FileNotFoundError for pictures that cannot
    be used, and OutputExistsError for a folder that exists.
    """
    watch = Stopwatch()
    paths = tuple(dict.fromkeys([*pictures, *([table] if table is not None else [])]))
    with whole_folder(out, force=force, inputs=paths) as folder:
        with watch.stage("read"):
            greys = [picture for path in paths for picture in _pictures(path, 1 if path == table else FILM_PICTURES)]
        height, width = _common_size(greys)
        with watch.stage("corners"):
            views = find_boards(greys, board)
        missing = tuple(name for (name, _), view in zip(greys, views, strict=True) if view is None)
        _demand_table(table, missing)
        with watch.stage("calibrate"):
            found = calibrate(_seen(views), width, height)
            placed = None if table is None else table_pose(found, board, str(table), thickness_m)
        notices = (*_not_found(missing), *found.notices)
        (folder / "camera.toml").write_text(camera_toml(found, placed), encoding="utf-8")
        write_json(folder / "calibration.json", _record(found, placed, board, missing))
        shown = eight_bits(dict(greys)[str(table)]) if table is not None else None
        page = calibration_page(found, placed, shown, board.square_m)
        (folder / "calibration.html").write_text(page, encoding="utf-8")
        write_provenance(folder, command=command, understood=board, inputs=paths, seconds=watch.seconds)
    return CameraFound(Path(out), found, placed, notices, len(greys))


def camera_toml(calibration: Calibration, table: TablePose | None) -> str:
    """The [camera] table of a scene."""
    lines = [
        "[camera]",
        f"width = {calibration.width_px}",
        f"height = {calibration.height_px}",
        f"matrix = {_listed(calibration.matrix)}",
        f"distortion = {_listed(calibration.distortion)}",
    ]
    if table is None:
        lines += ["# rotation and translation_m follow from a picture of the board on the table (--table)"]
    else:
        lines += [
            f"rotation = {_listed(table.camera.rotation)}",
            f"translation_m = {_listed(table.camera.translation_m)}",
            '# calibration = "calibration.json"   # how well all this is known; copy that file next to the scene',
        ]
    return "\n".join(lines) + "\n"


def _pictures(path: Path, count: int) -> list[tuple[str, Frame]]:
    """A picture with its name; of a film `count` frames or fewer, evenly spaced, the first one with the name of the film."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; wanted pictures or films of the board")
    if is_cine(path) or is_photron(path):
        return [(str(path), open_clip(path).frame(0))]
    if path.suffix.lower() in PICTURE_SUFFIXES:
        return [(str(path), read_picture(path))]
    film = open_at_any_rate(path)
    rows = np.unique(np.linspace(0, len(film) - 1, count).astype(int)).tolist()
    return [(f"{path}, frame {row}" if row else str(path), film.frame(row)) for row in rows]


def _common_size(greys: list[tuple[str, Frame]]) -> tuple[int, int]:
    """(height, width) of all pictures."""
    shape = greys[0][1].shape
    for name, grey in greys:
        if grey.shape != shape:
            raise InputError(
                f"{name}: the picture is {grey.shape[1]} × {grey.shape[0]} px and {greys[0][0]} {shape[1]} × {shape[0]}; "
                "take all pictures with the camera settings of the clips"
            )
    return int(shape[0]), int(shape[1])


def _seen(views: list[BoardView | None]) -> list[BoardView]:
    return [view for view in views if view is not None]


def _demand_table(table: Path | None, missing: tuple[str, ...]) -> None:
    if table is not None and str(table) in missing:
        raise InputError(
            f"{table}: no board is found on the picture of the table; check --board, --squares and --dictionary, "
            "or take it again, sharp and without glare"
        )


def _not_found(missing: tuple[str, ...]) -> tuple[str, ...]:
    if not missing:
        return ()
    names = ", ".join(Path(name).name for name in missing[:6]) + (", ..." if len(missing) > 6 else "")
    return (f"No board is found on {len(missing)} of the pictures ({names}).",)


def _listed(values: NDArray[np.float64]) -> str:
    """A TOML array in the shortest digits that round-trip."""
    return str(values.tolist())


def _record(
    calibration: Calibration, table: TablePose | None, board: Board, missing: tuple[str, ...]
) -> dict[str, Any]:
    free = [INTRINSICS.index(name) for name in calibration.free]
    joint = calibration.covariance if table is None else table.joint_covariance
    names = INTRINSICS if table is None else JOINT
    kept = [k for k, name in enumerate(names) if k in free or k >= len(INTRINSICS)]
    return {
        "board": vars(board),
        "width_px": calibration.width_px,
        "height_px": calibration.height_px,
        "intrinsics": {
            name: {"value": float(value), "sigma": float(sigma) if k in free else None, "fitted": k in free}
            for k, (name, value, sigma) in enumerate(
                zip(INTRINSICS, calibration.values, calibration.sigmas, strict=True)
            )
        },
        "covariance_names": [names[k] for k in kept],
        "covariance": joint[np.ix_(kept, kept)].tolist(),
        "sigma_px": calibration.sigma_px,
        "rms_px": calibration.rms_px,
        "pictures": [
            {
                "name": seen.view.name,
                "rms_px": seen.rms_px,
                "corners": seen.view.ids.tolist(),
                "seen_px": seen.view.pixels.tolist(),
                "residual_px": seen.residuals_px.tolist(),
            }
            for seen in calibration.boards
        ],
        "left_out": [{"name": name, "rms_px": rms} for name, rms in calibration.left_out],
        "not_found": list(missing),
        "corners_left_out": calibration.corners_left_out,
        "table": None if table is None else _table_record(table),
        "messages": list(calibration.notices),
    }


def _table_record(table: TablePose) -> dict[str, Any]:
    return {
        "rotation": table.camera.rotation.tolist(),
        "translation_m": table.camera.translation_m.tolist(),
        "camera_place_m": table.camera.centre_m.tolist(),
        "sigma_vertical_rad": table.tilt_sigma_rad,
        "rms_px": table.board.rms_px,
        "other_pose_rms_px": table.other_rms_px,
        "other_pose_rotation": None if table.other_rotation is None else table.other_rotation.tolist(),
    }
