"""One throw against the model: χ, the initial conditions and the effects that the throw shows.

`fit_throw` is the fit. It extends a trajectory bounce by bounce (`extension`) by single shooting (`shooting`), adds
effects that the evidence supports (`effects`), and simulates onward to the landing (`landing`). `Physics` is the die,
the table and the parameters of the laws in use, which predictions and joint fits share.
"""

from .clock_and_scale import in_true_units as in_true_units
from .extension import extend_through_bounces as extend_through_bounces
from .landing import landing_odds as landing_odds
from .landing import physics_of_fit as physics_of_fit
from .landing import resting_face as resting_face
from .landing import throw_of_fit as throw_of_fit
from .physics import CALIBRATION_LIMITS as CALIBRATION_LIMITS
from .physics import CENTRE_OF_MASS as CENTRE_OF_MASS
from .physics import COARSE as COARSE
from .physics import EFFECTS as EFFECTS
from .physics import Physics as Physics
from .physics import kernel_body as kernel_body
from .physics import table_under as table_under
from .shooting import Trajectory as Trajectory
from .shooting import first_flight_trajectory as first_flight_trajectory
from .shooting import inflated_covariance as inflated_covariance
from .shooting import weighted_as_inflated as weighted_as_inflated
from .throw_fit import INTERVAL_LEVEL as INTERVAL_LEVEL
from .throw_fit import fit_throw as fit_throw
from .throw_fit import parameters_of as parameters_of
