"""What a page tells of a run besides the throw itself: checks, the frames by themselves, and where the numbers come from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ...tracking.check import Finding
from ...tracking.track import Track


@dataclass(frozen=True, eq=False)
class ReportDetails:
    """What is empty or None is left out of the page."""

    frames: Track | None = None
    """The poses of single frames, as the fit saw them: their residuals show noise as noise."""
    findings: tuple[Finding, ...] = ()
    """Timing and calibration, as the finished throw shows them."""
    origin: Mapping[str, Any] | None = None
    """Version, command, inputs with their SHA-256, packages and timings, by the keys of `provenance.json`."""
