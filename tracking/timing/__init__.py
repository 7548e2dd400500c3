"""When each frame was taken: missing, doubled and frozen frames, found from the motion.

A die in flight is a clock. `motion_clock` compares the motion before and behind every gap between frames, and tells a step of
the clock from an impact; `repeated_pictures` finds frames that show the picture before them; `find_frame_times` puts both
together into corrected `FrameTimes`. `track_clip_in_time` tracks a clip, corrects its times, and tracks it again if they
changed."""

from .corrected_tracking import ITS_OWN as ITS_OWN
from .corrected_tracking import TIMINGS as TIMINGS
from .corrected_tracking import ClipClock as ClipClock
from .corrected_tracking import TimedTracking as TimedTracking
from .corrected_tracking import Timing as Timing
from .corrected_tracking import track_clip_in_time as track_clip_in_time
from .frame_times import FaultKind as FaultKind
from .frame_times import FrameFault as FrameFault
from .frame_times import FrameTimes as FrameTimes
from .frame_times import find_frame_times as find_frame_times
from .retimed_clip import clip_at_times as clip_at_times
