"""fitting.throw."""

from .clock_and_scale import in_true_units as in_true_units
from .extension import through_the_bounces as through_the_bounces
from .landing import landing_odds as landing_odds
from .landing import resting_face as resting_face
from .physics import LEAST_OF_CALIBRATION as LEAST_OF_CALIBRATION
from .physics import LOAD as LOAD
from .physics import QUICK as QUICK
from .physics import Physics as Physics
from .physics import kernel_body as kernel_body
from .shooting import Shot as Shot
from .shooting import opening as opening
from .throw_fit import INTERVAL_METHODS as INTERVAL_METHODS
from .throw_fit import LEVEL_OF_INTERVALS as LEVEL_OF_INTERVALS
from .throw_fit import IntervalMethod as IntervalMethod
from .throw_fit import fit_throw as fit_throw
