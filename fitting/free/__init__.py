"""fitting.free."""

from .flights import FEWEST_FRAMES as FEWEST_FRAMES
from .flights import FreeFlights as FreeFlights
from .flights import fit_flights as fit_flights
from .flights import flight_jacobian as flight_jacobian
from .flights import left_jacobian as left_jacobian
from .flights import moved_state as moved_state
from .impulses import Bounce as Bounce
from .impulses import apparent_restitution as apparent_restitution
from .impulses import common_restitution as common_restitution
from .impulses import measure_bounces as measure_bounces
from .loaded_die import LOAD as LOAD
from .loaded_die import Load as Load
from .loaded_die import load_in_flight as load_in_flight
from .shaken_table import SHAKE as SHAKE
from .shaken_table import shakes_seen as shakes_seen
