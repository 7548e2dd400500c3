"""What the report of an analysis tells besides the throw: how the finished track bears out its timing and calibration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ...replay.pages import ReportDetails
from ...tracking.check import Finding, contacts_of, fall_of, judge_throw, timing_of

if TYPE_CHECKING:
    from ...analysis import Tracking
    from ...files.scene import Scene


def account_of(scene: Scene, tracking: Tracking, origin: Mapping[str, Any]) -> ReportDetails:
    """The account of an analysis whose provenance is `origin`."""
    return ReportDetails(frames=tracking.unbiased, findings=findings_of(scene, tracking), origin=origin)


def findings_of(scene: Scene, tracking: Tracking) -> tuple[Finding, ...]:
    """Timing of the first camera's clip; scale, vertical and table from the flights and bounces of the whole throw."""
    clip = tracking.clips[0]
    return judge_throw(
        timing_of(clip, clip.notices),
        fall_of(tracking.frames, tracking.measured),
        contacts_of(tracking.measured, tracking.die),
        tracking.die,
        scene.clip.exposure_s,
    )
