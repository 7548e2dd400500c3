"""What a clip offers before it is tracked, and what a finished track says about scale, clock and camera.

`clip_quality` measures a clip on a few tracked frames, `gravity` the acceleration of the die in flight. `verdicts` judges both
with a sentence and a number for each respect, for `diethrow check` and for the report of an analysis. `doubtful_frames` names
the frames of a track whose poses contradict each other.
"""

from .clip_quality import ClipQuality as ClipQuality
from .clip_quality import TrackedPart as TrackedPart
from .clip_quality import contact_heights as contact_heights
from .clip_quality import fall_of_correlated_frames as fall_of_correlated_frames
from .clip_quality import frame_timing as frame_timing
from .clip_quality import measure_clip_quality as measure_clip_quality
from .doubtful_frames import doubtful_frame_notices as doubtful_frame_notices
from .gravity import fall_notices as fall_notices
from .gravity import measure_fall as measure_fall
from .second_die import SecondDie as SecondDie
from .second_die import find_second_die as find_second_die
from .verdicts import Finding as Finding
from .verdicts import Verdict as Verdict
from .verdicts import judge as judge
from .verdicts import judge_throw as judge_throw
