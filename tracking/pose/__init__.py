"""tracking.pose."""

from .by_hand import start_by_hand as start_by_hand
from .frame_poses import Looks as Looks
from .frame_poses import Picture as Picture
from .frame_poses import Seen as Seen
from .frame_poses import as_track as as_track
from .frame_poses import longest_leap as longest_leap
from .frame_poses import power_of_two as power_of_two
from .frame_poses import shown_whole as shown_whole
from .initial_pose import ALIKE as ALIKE
from .initial_pose import die_blobs as die_blobs
from .initial_pose import find_start as find_start
from .initial_pose import same_picture as same_picture
from .manual_input import FEWEST_CLICKS as FEWEST_CLICKS
from .manual_input import Click as Click
from .manual_input import HandStart as HandStart
from .manual_input import excluded_rows as excluded_rows
from .refine import Pose as Pose
from .refine import blur_step as blur_step
from .refine import contour_leans as contour_leans
from .refine import covariances as covariances
from .refine import refine_pose as refine_pose
from .refine import weak_prior as weak_prior
from .refine_kernels import look as look
from .refine_kernels import settle as settle
from .refine_kernels import sight_of as sight_of
from .refine_kernels import write as write
