"""The pose of the die on single frames.

`pose_candidates` finds candidates on a frame without any input, `manual_initial_pose` takes a pose or clicks from a
person, and `refine_pose` refines a pose on the edges of its frame and gives its covariance. `refine_and_score` and
`refine_frames` do that in compiled code, for one frame and for many; `tracking.sequence` and `tracking.clip_parameters`
call them. `reversed_pose` is the pose that draws nearly the same outline with near and far exchanged. `ClipPoses` holds
the poses of all frames of a clip, `SampledFrames` a sample of frames with their pictures. `unevenness` and `log_scatter`
say whether poses move as a die in flight, and `excess_on_same_pixels` makes the costs of several comparable.
"""

from .candidate_poses import SAME_POSE_EDGES as SAME_POSE_EDGES
from .candidate_poses import die_blobs as die_blobs
from .candidate_poses import pose_candidates as pose_candidates
from .candidate_poses import same_picture as same_picture
from .candidate_poses import velocity_across_m_s as velocity_across_m_s
from .clip_poses import ClipPoses as ClipPoses
from .clip_poses import Picture as Picture
from .clip_poses import SampledFrames as SampledFrames
from .clip_poses import as_track as as_track
from .clip_poses import exposure_times_s as exposure_times_s
from .clip_poses import longest_stride as longest_stride
from .clip_poses import power_of_two as power_of_two
from .clip_poses import wholly_in_view as wholly_in_view
from .depth_reversals import half_turn_about_sight as half_turn_about_sight
from .depth_reversals import reversed_pose as reversed_pose
from .evenness import UNEVEN as UNEVEN
from .evenness import log_scatter as log_scatter
from .evenness import unevenness as unevenness
from .manual_pose import FEWEST_CLICKS as FEWEST_CLICKS
from .manual_pose import Click as Click
from .manual_pose import ManualInitialisation as ManualInitialisation
from .manual_pose import excluded_rows as excluded_rows
from .manual_pose import manual_initial_pose as manual_initial_pose
from .refine import Pose as Pose
from .refine import bias_jacobians as bias_jacobians
from .refine import blur_step as blur_step
from .refine import covariances as covariances
from .refine import pose_state as pose_state
from .refine import refine_pose as refine_pose
from .refine import weak_prior as weak_prior
from .refine import weak_priors as weak_priors
from .refine_kernels import LEAST_CONTOUR_PX as LEAST_CONTOUR_PX
from .refine_kernels import WELL_SEEN as WELL_SEEN
from .refine_kernels import refine_and_score as refine_and_score
from .refine_kernels import refine_frames as refine_frames
from .refine_kernels import refine_uncertain as refine_uncertain
from .refine_kernels import seen_distance_m as seen_distance_m
from .refine_kernels import store_frame as store_frame
from .same_pixels import excess_on_same_pixels as excess_on_same_pixels
