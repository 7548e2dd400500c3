"""The expected picture of a die, and how well it agrees with the observed one.

From a pose, the die's shape, the cameras and the background follow the pixels that show it (`tracking.placed_die`).
`edge_equations` compares those beside every visible edge with a frame and adds the normal equations of the pose;
`surface_equations` compares the whole surface of a well-rounded die. The costs of a pose (`region_costs`, `region_cost`,
`pose_cost`, `costs_with_edge_noise`, `mirror_region_costs`; see `pose_costs`) judge it as a whole. `View` holds everything
about the scene that is the same on all frames, `PictureModel` the same for kernels. `segmentation` finds what differs from
the background, `occluders` what stands before the die.

`tracking.pose` refines and finds poses with these, `tracking.sequence` tracks with them, and `tracking.clip_parameters`
estimates blur, light and corner radius. `tracking.surface_marks` shares the projection and the linear algebra.
"""

from ..placed_die import BACKGROUND_SHARE as BACKGROUND_SHARE
from ..placed_die import BLUR as BLUR
from ..placed_die import CLEAR_PX as CLEAR_PX
from ..placed_die import CONTOUR as CONTOUR
from ..placed_die import CONTOUR_PX as CONTOUR_PX
from ..placed_die import EXPECTED_CLEAR_PX as EXPECTED_CLEAR_PX
from ..placed_die import LAMP_PRIOR as LAMP_PRIOR
from ..placed_die import LEAST_DEPTH_M as LEAST_DEPTH_M
from ..placed_die import LIGHT_TERMS as LIGHT_TERMS
from ..placed_die import LINE_LAGS as LINE_LAGS
from ..placed_die import LINE_PAIRS as LINE_PAIRS
from ..placed_die import LINE_PRODUCTS as LINE_PRODUCTS
from ..placed_die import LINE_SQUARES as LINE_SQUARES
from ..placed_die import LINES as LINES
from ..placed_die import LOG_NOISE as LOG_NOISE
from ..placed_die import NARROW_WINDOW_PX as NARROW_WINDOW_PX
from ..placed_die import PARAMETERS as PARAMETERS
from ..placed_die import PIXELS as PIXELS
from ..placed_die import RESPONSE as RESPONSE
from ..placed_die import ROBUST_COST as ROBUST_COST
from ..placed_die import ROW_ITERATIONS as ROW_ITERATIONS
from ..placed_die import SPHERE as SPHERE
from ..placed_die import STATISTICS as STATISTICS
from ..placed_die import STRETCHES as STRETCHES
from ..placed_die import WINDOW_PX as WINDOW_PX
from ..placed_die import CameraRig as CameraRig
from ..placed_die import EdgeSampling as EdgeSampling
from ..placed_die import FrameWindows as FrameWindows
from ..placed_die import LightPrior as LightPrior
from ..placed_die import NormalEquations as NormalEquations
from ..placed_die import PictureModel as PictureModel
from ..placed_die import PoseRows as PoseRows
from ..placed_die import PoseState as PoseState
from ..placed_die import RefinementSettings as RefinementSettings
from ..placed_die import Shape as Shape
from ..placed_die import Workspace as Workspace
from ..placed_die import begin_light as begin_light
from ..placed_die import cholesky_factor as cholesky_factor
from ..placed_die import crop_windows as crop_windows
from ..placed_die import defocus_variance as defocus_variance
from ..placed_die import exposure_delay as exposure_delay
from ..placed_die import inverse_positive as inverse_positive
from ..placed_die import keep_light as keep_light
from ..placed_die import kept_light as kept_light
from ..placed_die import lens_blur_at as lens_blur_at
from ..placed_die import new_equations as new_equations
from ..placed_die import new_workspace as new_workspace
from ..placed_die import normal_monomials as normal_monomials
from ..placed_die import pixel_of_ray as pixel_of_ray
from ..placed_die import product as product
from ..placed_die import reach_of_die as reach_of_die
from ..placed_die import rotation_exp as rotation_exp
from ..placed_die import rotation_log as rotation_log
from ..placed_die import scale_px as scale_px
from ..placed_die import solve_factored as solve_factored
from ..placed_die import solve_positive as solve_positive
from ..placed_die import strips_of_any_shade as strips_of_any_shade
from ..placed_die import turn as turn
from ..placed_die import turn_from as turn_from
from ..placed_die import turned_within as turned_within
from ..placed_die import unknown_light as unknown_light
from ..placed_die import update_light as update_light
from .edge_equations import SHADED_STRETCH_PX as SHADED_STRETCH_PX
from .edge_equations import add_edge_equations as add_edge_equations
from .edge_stretch import BIWEIGHT_CUT as BIWEIGHT_CUT
from .edge_stretch import NORMAL_MAD as NORMAL_MAD
from .edge_stretch import update_shared_greys as update_shared_greys
from .noise_correlation import independent_share as independent_share
from .occluders import OCCLUDED_SHARE as OCCLUDED_SHARE
from .occluders import OccluderMask as OccluderMask
from .occluders import update_occluder_mask as update_occluder_mask
from .pose_costs import clear_shares as clear_shares
from .pose_costs import costs_with_edge_noise as costs_with_edge_noise
from .pose_costs import edges_cost as edges_cost
from .pose_costs import mirror_region_costs as mirror_region_costs
from .pose_costs import region_costs as region_costs
from .pose_costs import supports as supports
from .region_cost import SUPPORT_COST as SUPPORT_COST
from .region_cost import clear_steps_cost as clear_steps_cost
from .region_cost import pose_cost as pose_cost
from .region_cost import region_cost as region_cost
from .segmentation import Blob as Blob
from .segmentation import Mask as Mask
from .segmentation import PixelNoise as PixelNoise
from .segmentation import background_noise as background_noise
from .segmentation import differs_clearly as differs_clearly
from .segmentation import differs_from_background as differs_from_background
from .segmentation import largest_blob as largest_blob
from .segmentation import level_step as level_step
from .segmentation import pixel_noise as pixel_noise
from .segmentation import without_rims as without_rims
from .segmentation import without_shadow as without_shadow
from .surface_equations import add_picture_equations as add_picture_equations
from .surface_equations import compares_surface as compares_surface
from .view import THREADS as THREADS
from .view import Array as Array
from .view import Image as Image
from .view import Lens as Lens
from .view import View as View
from .view import flight_from as flight_from
from .view import make_view as make_view
from .view import outline_box as outline_box
from .view import outline_mask as outline_mask
from .view import refinement_boxes as refinement_boxes
from .view import share_in_view as share_in_view
from .view import shares_in_view as shares_in_view
from .view import stack_pictures as stack_pictures
from .view import visible_faces as visible_faces
from .view import whole_frame_windows as whole_frame_windows
from .view import with_corner_radius as with_corner_radius
from .view import with_first_camera_only as with_first_camera_only
from .view import with_lens as with_lens
from .view import with_occluder_mask as with_occluder_mask
from .view import with_reflections as with_reflections
