"""Poses of a whole clip: tracking from frame to frame, and refinement of every frame.

`track_clip` is the entry: an initial pose is found (`initialisation`), the die is tracked in both directions (`frame_to_frame`,
`motion_filter`, `tracking_pass`), depth reversals are corrected (`depth_reversal`), the labelling is made consistent
(`labelling`), and all frames are refined along the measured flights, on edges (`refine_on_edges`) and on surface marks
(`refine_on_marks`). `acceptance` has the thresholds that accept a pose. Commands and the check of a clip use `track_clip`."""

from .tracker import NO_FACTS as NO_FACTS
from .tracker import Background as Background
from .tracker import ClipFacts as ClipFacts
from .tracker import Progress as Progress
from .tracker import TrackedClip as TrackedClip
from .tracker import track_clip as track_clip
from .tracking_pass import NoDieError as NoDieError
