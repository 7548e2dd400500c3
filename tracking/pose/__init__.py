"""tracking.pose."""

from .by_hand import manual_initial_pose as manual_initial_pose
from .frame_poses import ClipPoses as ClipPoses
from .frame_poses import Picture as Picture
from .frame_poses import SampledFrames as SampledFrames
from .frame_poses import as_track as as_track
from .frame_poses import longest_leap as longest_leap
from .frame_poses import power_of_two as power_of_two
from .frame_poses import shown_whole as shown_whole
from .initial_pose import ALIKE as ALIKE
from .initial_pose import die_blobs as die_blobs
from .initial_pose import initial_poses as initial_poses
from .initial_pose import same_picture as same_picture
from .manual_input import FEWEST_CLICKS as FEWEST_CLICKS
from .manual_input import Click as Click
from .manual_input import ManualInitialisation as ManualInitialisation
from .manual_input import excluded_rows as excluded_rows
from .refine import Pose as Pose
from .refine import blur_step as blur_step
from .refine import contour_bias_jacobians as contour_bias_jacobians
from .refine import covariances as covariances
from .refine import refine_pose as refine_pose
from .refine import weak_prior as weak_prior
from .refine_kernels import crop_windows as crop_windows
from .refine_kernels import refine_and_score as refine_and_score
from .refine_kernels import refine_frames as refine_frames
from .refine_kernels import store_frame as store_frame
