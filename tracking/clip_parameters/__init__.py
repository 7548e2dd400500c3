"""tracking.clip_parameters."""

from .clock_offsets import Offsets as Offsets
from .clock_offsets import find_offsets as find_offsets
from .clock_offsets import rig_at as rig_at
from .corner_radius import FRAMES as FRAMES
from .corner_radius import Corners as Corners
from .corner_radius import Rounding as Rounding
from .corner_radius import by_flights as by_flights
from .corner_radius import by_free_poses as by_free_poses
from .corner_radius import contour_sigma_px as contour_sigma_px
from .corner_radius import look_rounded as look_rounded
from .corner_radius import looks_in_flight as looks_in_flight
from .lens_blur import BLUR_FRAMES as BLUR_FRAMES
from .lens_blur import lens_blur_px as lens_blur_px
from .light import lit as lit
