"""How a clip is analysed, as the options of `analyze`, `track` and `batch` say it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from ...model.errors import InputError

Stage = Literal["analyze", "track"]


@dataclass(frozen=True)
class RunOptions:
    """The values of the options."""

    quality: str = "standard"
    every: int = 1
    shrink: int = 1
    timing: str = "corrected"
    intervals: str = "profile"
    """Of `analyze` alone, as the two below."""
    embed_replay: bool = False
    figures: bool = False

    def words(self, stage: Stage) -> tuple[str, ...]:
        """The options as typed: the quality, and the others where they differ from the usual."""
        names = ("every", "shrink", "timing", *(("intervals",) if stage == "analyze" else ()))
        given = [name for name in names if getattr(self, name) != getattr(USUAL_OPTIONS, name)]
        words = [word for name in given for word in (f"--{name}", str(getattr(self, name)))]
        flags = ("embed_replay", "figures") if stage == "analyze" else ()
        drawn = [f"--{name.replace('_', '-')}" for name in flags if getattr(self, name)]
        return ("--quality", self.quality, *words, *drawn)

    def refuse_those_of_analyze(self) -> None:
        """Raise ValueError, naming the option, for one that the tracking stage does not have."""
        own = self.words("track")
        for word in self.words("analyze"):
            if word.startswith("--") and word not in own:
                raise InputError(f"{word} beside --only-track: the tracking stage has no such option; leave it out")

    def arguments(self, stage: Stage) -> dict[str, Any]:
        """The same as arguments of `analyze` or of `track_only`. Raises ValueError for a value that is none."""
        from ...fitting.results import INTERVAL_METHODS
        from ...runs import Shown
        from ...tracking.footage import Decimation
        from ...tracking.quality import QUALITIES
        from ...tracking.timing import TIMINGS

        for name, known in (("quality", QUALITIES), ("timing", TIMINGS), ("intervals", INTERVAL_METHODS)):
            if getattr(self, name) not in known:
                raise InputError(f"--{name} {getattr(self, name)}: wanted {', '.join(known)}")
        tracking = {
            "quality": QUALITIES[self.quality],
            "decimation": Decimation(self.every, self.shrink),
            "timing": self.timing,
        }
        if stage == "track":
            return tracking
        return {**tracking, "intervals": self.intervals, "shown": Shown(self.embed_replay, self.figures)}


USUAL_OPTIONS = RunOptions()
"""Of commands without any option."""
