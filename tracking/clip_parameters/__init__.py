"""What all frames of a clip share, estimated from its pictures: empty scene, response, light, lens blur, corner radius,
clock offsets.

The tracker in `sequence` estimates them between its passes and gives them to the model of the picture; `check` reports them.
"""

from .clock_offsets import ClockOffsets as ClockOffsets
from .clock_offsets import estimate_clock_offsets as estimate_clock_offsets
from .clock_offsets import rig_at as rig_at
from .corner_radius import RADIUS_FRAMES as RADIUS_FRAMES
from .corner_radius import CornerRadius as CornerRadius
from .corner_radius import CornerRounding as CornerRounding
from .corner_radius import contour_sigma_px as contour_sigma_px
from .corner_radius import gain_over_sharp as gain_over_sharp
from .corner_radius import is_clearly_rounded as is_clearly_rounded
from .corner_radius import is_rounded as is_rounded
from .corner_radius import largest_radius_m as largest_radius_m
from .corner_radius import radius_by_free_poses as radius_by_free_poses
from .corner_radius import radius_on_flights as radius_on_flights
from .corner_radius import sample_in_flight as sample_in_flight
from .empty_scene import EmptyScene as EmptyScene
from .empty_scene import empty_scene as empty_scene
from .lens_blur import BLUR_FRAMES as BLUR_FRAMES
from .lens_blur import depth_of_field as depth_of_field
from .lens_blur import estimate_lens as estimate_lens
from .light import with_light as with_light
from .radius_by_impacts import SUFFICIENT_FRAMES as SUFFICIENT_FRAMES
from .radius_by_impacts import flies_as_before as flies_as_before
from .radius_by_impacts import open_contour_notice as open_contour_notice
from .radius_by_impacts import radius_by_impacts as radius_by_impacts
from .radius_by_impacts import unexplained_contacts as unexplained_contacts
from .radius_by_surface import SURFACE_FRAMES as SURFACE_FRAMES
from .radius_by_surface import may_be_rounder as may_be_rounder
from .radius_by_surface import radius_by_surface as radius_by_surface
from .radius_by_surface import surface_gain_over_sharp as surface_gain_over_sharp
from .response import EstimatedResponse as EstimatedResponse
from .response import estimate_response as estimate_response
