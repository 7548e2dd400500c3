"""What needs no impact law: single flights, single impacts, a centre-of-mass offset, and the motion of the table.

`fit_flights` fits every flight of a measured throw by itself. `apparent_restitution` and `measure_bounces` measure the
impact between two flights. `mass_offset_from_flights` and `table_motion_candidates` show whether the die is loaded and
whether the table oscillates. Fits of whole throws start from these values and are judged by their residuals.
"""

from .flights import MIN_FRAMES as MIN_FRAMES
from .flights import FreeFlights as FreeFlights
from .flights import fit_flights as fit_flights
from .impulses import Bounce as Bounce
from .impulses import apparent_restitution as apparent_restitution
from .impulses import common_restitution as common_restitution
from .impulses import measure_bounces as measure_bounces
from .loaded_die import CENTRE_OF_MASS as CENTRE_OF_MASS
from .loaded_die import MassOffset as MassOffset
from .loaded_die import mass_offset_from_flights as mass_offset_from_flights
from .oscillating_table import TABLE_MOTION as TABLE_MOTION
from .oscillating_table import table_motion_candidates as table_motion_candidates
