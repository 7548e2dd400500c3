"""`diethrow check`: the quality of a clip before tracking; every finding with a verdict and advice."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from ...files.csv_and_json import write_json
from ...files.outputs import whole_folder
from ...files.provenance import Stopwatch, write_provenance
from ...files.scene import Scene, View
from ...files.settings import SceneError
from ...replay.pages import check_page
from ...tracking.check import ClipQuality, Finding, TrackedPart, Verdict, judge, measure_clip_quality
from ...tracking.footage import Clip, clip_in_light, level_grey
from ...tracking.pose import ManualInitialisation
from ...tracking.sequence import ClipFacts
from ...tracking.timing import ClipClock, Timing
from .footage import open_background, open_footage, open_frames, readout_of_frames, turned_deg
from .track import check_scene, input_paths


@dataclass(frozen=True, eq=False)
class Check:
    """Result of `check_clip`."""

    findings: tuple[Finding, ...]
    """With several cameras each finding names its camera: `pixels, camera 2`."""
    measured: tuple[ClipQuality, ...]
    """One per camera."""

    @property
    def bad(self) -> bool:
        """Whether a finding must be corrected before tracking."""
        return any(finding.verdict is Verdict.BAD for finding in self.findings)


def check_clip(
    scene: Scene,
    out: Path | None = None,
    *,
    timing: Timing = "corrected",
    force: bool = False,
    command: tuple[str, ...] = (),
) -> Check:
    """Examine the clips of a scene, one per camera; with `out`, write check.json and check.html to that folder.
    `timing` says whether missing and repeated frames are corrected.

    Raises SceneError for footage that does not fit the scene, and OutputExistsError for a folder that exists.
    """
    check_scene(scene)
    if out is None:
        return _check(scene, timing, Stopwatch())[0]
    watch = Stopwatch()
    with whole_folder(out, force=force, inputs=input_paths(scene)) as folder:
        check, clips = _check(scene, timing, watch)
        write_json(folder / "check.json", record(check))
        tracked_parts = [
            (measured.tracked_part, clip, view.camera)
            for measured, clip, view in zip(check.measured, clips, scene.views(), strict=True)
        ]
        page = check_page(scene.name, check.findings, tracked_parts, scene.die)
        (folder / "check.html").write_text(page, encoding="utf-8")
        write_provenance(folder, command=command, understood=scene, inputs=input_paths(scene), seconds=watch.seconds)
    return check


def _check(scene: Scene, timing: Timing, watch: Stopwatch) -> tuple[Check, list[Clip]]:
    views = scene.views()
    findings: list[Finding] = []
    measured = []
    with watch.stage("open"):
        clips = [open_footage(scene, view) for view in views]
        used = readout_of_frames(scene, clips)
    for k, (view, clip) in enumerate(zip(views, clips, strict=True)):
        with watch.stage("check"):
            # An initial pose by hand was clicked in the first camera's picture.
            quality = _measured(used, view, clip, timing, scene.start if k == 0 else None)
            measured.append(_by_rows_of_file(quality, clip))
        found = judge(measured[-1], scene.die, scene.clip.exposure_s, scene.rounding, scene.clip.readout_s)
        findings += found if len(views) == 1 else [replace(each, name=f"{each.name}, camera {k + 1}") for each in found]
    return Check(tuple(findings), tuple(measured)), clips


def _by_rows_of_file(quality: ClipQuality, clip: Clip) -> ClipQuality:
    """The same with the readout from the first row to the last of the file, where its frames are turned upside down."""
    part = quality.tracked_part
    if part is None or part.readout is None or turned_deg(clip) != 180:
        return quality
    readout = replace(part.readout, readout_s=-part.readout.readout_s)
    return replace(quality, tracked_part=replace(part, readout=readout))


def _measured(scene: Scene, view: View, clip: Clip, timing: Timing, start: ManualInitialisation | None) -> ClipQuality:
    """Measurements on the clip of one camera."""
    background, response = open_background(scene, view, clip), scene.clip.response

    def open_part(first: int, stop: int) -> Clip:
        return clip_in_light(open_frames(scene, view, (first, stop), part_of=clip), response)

    try:
        exposure_s = scene.clip.exposure_s or clip.metadata().get("exposure_s")
        facts = ClipFacts(
            exposure_s,
            start=start,
            excluded=scene.clip.excluded,
            rounding=scene.rounding,
            level_grey=level_grey(clip, response),
            readout_s=scene.clip.readout_s,
            gravity_m_s2=scene.table.gravity_m_s2,
        )
        light = clip_in_light(clip, response)
        return measure_clip_quality(
            light, view.camera, scene.die, open_part, background=background, facts=facts, clock=ClipClock(timing)
        )
    except (ValueError, OSError) as error:
        raise SceneError(f"{scene.path}: {error}") from error


def record(check: Check) -> dict[str, object]:
    """The contents of check.json."""
    tried = [_frames_tried(measured.tracked_part) for measured in check.measured]
    return {
        "verdict": max((finding.verdict for finding in check.findings), key=list(Verdict).index).value,
        "frames_tried": tried[0] if len(tried) == 1 else tried,
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


def _frames_tried(tracked_part: TrackedPart | None) -> list[int] | None:
    return None if tracked_part is None else [int(tracked_part.track.frame[0]), int(tracked_part.track.frame[-1]) + 1]
