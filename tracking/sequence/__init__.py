"""Poses of a whole clip: tracking, and refinement of every frame.

`track_clip` is the entry. A tracking pass (`tracking_pass`) finds an initial pose (`initialisation`), tracks the die in both
directions, and back from the end through the impacts (`backward_pass`); finds the die again where it was lost (`lost_ranges`,
`places`), and corrects depth reversals (`depth_reversal`). `compare_poses` decides between two sequences of poses. With rounded
corners the pass is repeated (`rounded_corners`). Then the labelling is made consistent (`labelling`), and all frames are refined
along the measured flights, on edges (`refine_on_edges`) and on surface marks (`refine_on_marks`). Commands and the check of a
clip use `track_clip`."""

from .tracker import NO_FACTS as NO_FACTS
from .tracker import Background as Background
from .tracker import ClipFacts as ClipFacts
from .tracker import Progress as Progress
from .tracker import TrackedClip as TrackedClip
from .tracker import track_clip as track_clip
from .tracking_pass import NoDieError as NoDieError
