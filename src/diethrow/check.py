"""`diethrow check`: what a clip offers, before it is tracked: every respect with a verdict and what to change."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .analyze import check_scene, input_paths, open_footage
from .outputs import whole_folder
from .provenance import Stopwatch, write_provenance
from .records import write_json
from .replay.check_page import check_page
from .scene import Scene, View
from .settings import SceneError
from .tracking.background import load_background
from .tracking.clip import Clip, open_clip
from .tracking.preflight import Preflight, preflight
from .tracking.verdicts import Finding, Verdict, judge


@dataclass(frozen=True, eq=False)
class Check:
    """What `check_clip` found."""

    findings: tuple[Finding, ...]
    measured: Preflight

    @property
    def bad(self) -> bool:
        """Whether something should be put right first."""
        return any(finding.verdict is Verdict.BAD for finding in self.findings)


def check_clip(scene: Scene, out: Path | None = None, *, force: bool = False, command: tuple[str, ...] = ()) -> Check:
    """Look at the clip of a scene; with `out`, check.json and check.html are written to that folder.

    Raises SceneError for footage that does not fit the scene, and OutputExistsError for a folder that exists.
    """
    check_scene(scene)
    if out is None:
        return _check(scene, Stopwatch())[0]
    watch = Stopwatch()
    with whole_folder(out, force=force, inputs=input_paths(scene)) as folder:
        check, clip = _check(scene, watch)
        write_json(folder / "check.json", _record(check))
        camera, title = scene.views()[0].camera, scene.path.resolve().parent.name
        page = check_page(title, check.findings, check.measured.sight, clip, camera, scene.die)
        (folder / "check.html").write_text(page, encoding="utf-8")
        write_provenance(
            folder / "provenance.json",
            command=command,
            understood=scene,
            inputs=input_paths(scene),
            seconds=watch.seconds,
        )
    return check


def _check(scene: Scene, watch: Stopwatch) -> tuple[Check, Clip]:
    view = scene.views()[0]
    with watch.stage("open"):
        clip = open_footage(scene, view)
        background = _background(view, clip, scene)

    def open_part(first: int, stop: int) -> Clip:
        assert view.path is not None, "views() demands paths"
        return open_clip(view.path, fps=scene.clip.fps, frame_range=(first, stop))

    exposure_s = scene.clip.exposure_s or clip.metadata().get("exposure_s")
    try:
        with watch.stage("check"):
            measured = preflight(
                clip,
                view.camera,
                scene.die,
                open_part,
                background=background,
                exposure_s=exposure_s,
                start=scene.start,
                excluded=scene.clip.excluded,
            )
    except (ValueError, OSError) as error:
        raise SceneError(f"{scene.path}: {error}") from error
    return Check(judge(measured, scene.die, scene.clip.exposure_s), measured), clip


def _background(view: View, clip: Clip, scene: Scene) -> NDArray[np.float32] | None:
    if view.background_path is None:
        return None
    try:
        return load_background(view.background_path, clip)
    except (ValueError, OSError) as error:
        raise SceneError(f"{scene.path}: clip.background = {view.background_path.name}: {error}") from error


def _record(check: Check) -> dict[str, object]:
    sight = check.measured.sight
    tried = None if sight is None else [int(sight.track.frame[0]), int(sight.track.frame[-1]) + 1]
    return {
        "verdict": max((finding.verdict for finding in check.findings), key=list(Verdict).index).value,
        "frames_tried": tried,
        "findings": [
            {
                "name": finding.name,
                "verdict": finding.verdict.value,
                "measured": finding.measured,
                "advice": finding.advice,
                "values": finding.values,
            }
            for finding in check.findings
        ],
    }
