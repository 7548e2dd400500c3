"""Tracking of the die from one frame to the next, through impacts.

`FrameTracker` follows the die: in flight by its motion (`motion_filter`), behind an impact by trials of what may have happened
there (`impact_trials`, `even_rotation`). `acceptance` has the thresholds that accept a pose. `track_both_ways` follows it to
both ends of a clip, the `TrackingTask`. `tracking.sequence` makes the poses of whole clips from that."""

from .acceptance import AMBIGUOUS_COST as AMBIGUOUS_COST
from .acceptance import FASTEST_M_S as FASTEST_M_S
from .acceptance import HEIGHT_SIGMAS as HEIGHT_SIGMAS
from .acceptance import KNOWN_RAD as KNOWN_RAD
from .acceptance import MIN_POSES_OF_FLIGHT as MIN_POSES_OF_FLIGHT
from .acceptance import MIN_SUPPORT as MIN_SUPPORT
from .acceptance import MIN_SUPPORT_CUT as MIN_SUPPORT_CUT
from .acceptance import ON_PATH_SUPPORT as ON_PATH_SUPPORT
from .frame_tracker import BACKWARDS_MISSES as BACKWARDS_MISSES
from .frame_tracker import MOST_CANDIDATES as MOST_CANDIDATES
from .frame_tracker import FrameTracker as FrameTracker
from .impact_trials import is_high as is_high
from .impact_trials import motion_of_poses as motion_of_poses
from .motion_filter import DELAY_ITERATIONS as DELAY_ITERATIONS
from .motion_filter import ENOUGH_EXCESS_COST as ENOUGH_EXCESS_COST
from .motion_filter import lowest_m as lowest_m
from .tracking_task import TrackingTask as TrackingTask
from .tracking_task import track_both_ways as track_both_ways
