"""tracking.sequence."""

from .tracker import NoDieError as NoDieError
from .tracker import TrackedClip as TrackedClip
from .tracker import track_clip as track_clip
