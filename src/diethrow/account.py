"""What the report of an analysis tells besides the throw: how the finished track bears out its timing and calibration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from .replay.account import Account
from .tracking.preflight import contacts_of, fall_of, timing_of
from .tracking.verdicts import Finding, judge_throw

if TYPE_CHECKING:
    from .analyze import Tracking
    from .scene import Scene


def account_of(scene: Scene, tracking: Tracking, origin: Mapping[str, Any]) -> Account:
    """The account of an analysis whose provenance is `origin`."""
    return Account(frames=tracking.straight, findings=findings_of(scene, tracking), origin=origin)


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
