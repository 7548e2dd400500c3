"""The footage of a scene: the frames of a view as its camera is calibrated for them, and the background picture.

A phone that is held upright stores its frames on their side and asks players to turn them. Tracking uses turned frames, as a
calibration does that was made on pictures of a player or of OpenCV. A camera whose size is that of the stored frames was
calibrated on those, and they are left as they are stored.

The raw mosaic of a colour sensor is smoothed away, in the frames and in the background picture alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...files.analysis_folder import AnalysedThrow
from ...files.scene import Scene, View
from ...files.settings import SceneError, refuse
from ...model.errors import InputError
from ...tracking.footage import (
    MOSAIC,
    TURNED,
    Clip,
    Decimation,
    clip_without_mosaic,
    has_mosaic,
    load_background,
    mosaic_of,
    open_clip,
    picture_in_light,
    shows_one_picture,
    smoothed,
)
from ...tracking.timing import clip_at_times

TRIAL_FPS = 1000.0
"""Rate with which a file that has none is opened to be looked at."""
SAME_INTERVAL = 1e-3
"""Share by which the rate of a file may differ from the scene's when times are compared with the frame interval."""


def open_footage(scene: Scene, view: View) -> Clip:
    """The clip of a view. Raises SceneError if it is unreadable or its frames do not have the camera's size."""
    assert view.path is not None, "views() demands paths"
    try:
        clip = open_frames(scene, view, scene.clip.frame_range)
    except (ValueError, OSError) as error:
        raise SceneError(f"{scene.path}: clip.path = {view.path.name}: {error}") from error
    camera = view.camera
    if (clip.width_px, clip.height_px) != (camera.width_px, camera.height_px):
        turned = f", {TURNED}" if turned_deg(clip) else ""
        wanted = f"the frames of {view.path.name} have {clip.width_px} × {clip.height_px} px{turned}; wanted their own camera"
        raise refuse(scene.path, "camera.width and camera.height", [camera.width_px, camera.height_px], wanted)
    _check_times(scene, clip)
    if shows_one_picture(clip):
        wanted = f"all {len(clip)} frames of it are copies of one picture; wanted a film of a throw"
        raise refuse(scene.path, "clip.path", view.path.name, wanted)
    return clip


def open_frames(scene: Scene, view: View, frame_range: tuple[int, int] | None, *, part_of: Clip | None = None) -> Clip:
    """Frames of a view as its camera is calibrated for them, without any check, and without a mosaic: that of `part_of`, if it is
    given. Raises ValueError or OSError if they are unreadable."""
    assert view.path is not None, "views() demands paths"
    camera, fps = view.camera, scene.clip.fps
    clip = open_clip(view.path, fps=fps, frame_range=frame_range)
    is_on_its_side = turned_deg(clip) % 180 == 90 and clip.width_px != clip.height_px
    if is_on_its_side and (clip.height_px, clip.width_px) == (camera.width_px, camera.height_px):
        clip = open_clip(view.path, fps=fps, frame_range=frame_range, as_stored=True)
    if part_of is not None:
        notice = next((notice for notice in part_of.notices if MOSAIC in notice), None)
    else:
        mosaic = mosaic_of(clip)
        notice = None if mosaic is None else mosaic.notice(view.path.name)
    return clip if notice is None else clip_without_mosaic(clip, notice)


def readout_of_frames(scene: Scene, clips: Sequence[Clip]) -> Scene:
    """The scene with the readout of its clips' frames as they are used: turned upside down, the last row is exposed first.

    Raises SceneError where a quarter turn has made columns of the rows, or where only some of the clips are upside down.
    """
    readout_s, turns_deg = scene.clip.readout_s, [turned_deg(clip) for clip in clips]
    if readout_s == 0.0 or not any(turns_deg):
        return scene
    if any(turn_deg % 180 for turn_deg in turns_deg):
        wanted = (
            "the frames are turned by a quarter, so that their columns are exposed one after the other; wanted 0, or [camera] "
            "and background of the frames as they are stored, on their side"
        )
        raise refuse(scene.path, "clip.readout_s", readout_s, wanted)
    if len(set(turns_deg)) > 1:
        wanted = "some of the clips are turned by 180° and others are not; wanted 0, or clips that are all turned alike"
        raise refuse(scene.path, "clip.readout_s", readout_s, wanted)
    return replace(scene, clip=replace(scene.clip, readout_s=-readout_s))


def turned_deg(clip: Clip) -> int:
    """Angle by which the reader has turned the frames, counter-clockwise [deg]."""
    return int(clip.metadata().get("turned_deg", 0))


def _check_times(scene: Scene, clip: Clip) -> None:
    """Raises SceneError if the scene's exposure or readout is longer than the frame interval of a file that has its own rate."""
    interval_s = float(np.median(np.diff(clip.times_s))) if len(clip) > 1 else np.inf
    for name in ("exposure_s", "readout_s"):
        value = getattr(scene.clip, name)
        if value and value > interval_s * (1.0 + SAME_INTERVAL):
            wanted = f"wanted seconds, at most the {interval_s:.4g} s between two frames of the file"
            raise refuse(scene.path, f"clip.{name}", value, wanted)


def open_background(scene: Scene, view: View, clip: Clip) -> NDArray[np.float32] | None:
    """The background picture of a view, in light where the scene gives a response; None without one.

    Raises SceneError where it cannot be read, or does not fit."""
    if view.background_path is None:
        return None
    try:
        picture = load_background(view.background_path, clip)
        return picture_in_light(smoothed(picture) if has_mosaic(clip) else picture, clip, scene.clip.response)
    except (ValueError, OSError) as error:
        raise SceneError(f"{scene.path}: clip.background = {view.background_path.name}: {error}") from error


def first_clip(scene: Scene, decimation: Decimation) -> Clip:
    """The frames of the first camera that an analysis uses, for another reader. Raises as `open_frames`, without its checks."""
    view = scene.views()[0]
    clip = open_frames(scene, view, scene.clip.frame_range)
    return clip if decimation.is_whole else decimation.clip(clip)


def clip_of_analysis(found: AnalysedThrow) -> Clip | None:
    """The footage of a saved analysis at the times of its track; None where it is gone, or has other frames now."""
    track = found.record.track
    try:
        clip = open_footage(found.scene, found.scene.views()[0])
        if not found.decimation.is_whole:
            clip = found.decimation.clip(clip)
    except (OSError, ValueError):
        return None
    return clip_at_times(clip, track.time_s) if len(clip) == len(track) else None


def open_at_any_rate(path: Path) -> Clip:
    """A film, with its own recording rate or, where it has none, with one to look at it. Raises ValueError and OSError as
    `open_clip`."""
    try:
        return open_clip(path)
    except InputError:
        return open_clip(path, fps=TRIAL_FPS)
