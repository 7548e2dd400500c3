"""tracking.sequence."""

from .track_clip import Followed as Followed
from .track_clip import NoDieError as NoDieError
from .track_clip import look_through as look_through
