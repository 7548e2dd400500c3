"""Compiled kernels of the event loop: touch, impact, flight, held contact, and derivatives, on plain numbers and arrays.

They stand in one file because they call each other (the cache of a kernel sees edits of its own file only). The
methods are explained where the friendly functions are: `touch` (the first root), `impacts` (the laws), `tables`,
`contact` (chatter and held contact), `simulate` (the loop and its ends), `tangent` (derivatives).

A state is an array (13,): position [m], quaternion wxyz, velocity [m/s], angular velocity [rad/s], all in the axes of
the table: z along its normal.
"""

from .air import Air as Air
from .air import Vacuum as Vacuum
from .air import drag_trajectory as drag_trajectory
from .event_loop import carry_on_face as carry_on_face
from .event_loop import land_many as land_many
from .event_loop import poses_of_throws as poses_of_throws
from .event_loop import run_throw as run_throw
from .flight import advance as advance
from .flight import first_touch as first_touch
from .flight import height_terms as height_terms
from .flight import lever_arm as lever_arm
from .flight import spin_rate as spin_rate
from .flight import table_height as table_height
from .flight import table_velocity as table_velocity
from .held_contact import clearance as clearance
from .held_contact import held_step as held_step
from .impact import ParameterDerivatives as ParameterDerivatives
from .impact import impulse as impulse
from .impact import impulse_gradient as impulse_gradient
from .log import decided_face as decided_face
from .log import lowest_face_row as lowest_face_row
from .sliding_contact import friction_step as friction_step
from .sliding_contact import inelastic_impulse as inelastic_impulse
from .sliding_contact import move_freely as move_freely
from .slip import coefficient_at_speed as coefficient_at_speed
from .slip import contact_matrix as contact_matrix
from .slip import friction_impulse as friction_impulse
from .slip import spherical_contact_matrix as spherical_contact_matrix
from .types import BALANCED as BALANCED
from .types import CHATTER as CHATTER
from .types import COULOMB as COULOMB
from .types import COULOMB_BY_SPEED as COULOMB_BY_SPEED
from .types import COULOMB_FADING as COULOMB_FADING
from .types import FALSE as FALSE
from .types import FINE as FINE
from .types import IMPACT_CAP as IMPACT_CAP
from .types import IMPACTS_REACHED as IMPACTS_REACHED
from .types import LEVEL as LEVEL
from .types import NEWTON as NEWTON
from .types import NO_LIMIT as NO_LIMIT
from .types import POISSON as POISSON
from .types import RESTED as RESTED
from .types import SMOOTH as SMOOTH
from .types import SMOOTH_BY_SPEED as SMOOTH_BY_SPEED
from .types import SPINNING as SPINNING
from .types import STRONGE as STRONGE
from .types import TIME_REACHED as TIME_REACHED
from .types import TIMED_OUT as TIMED_OUT
from .types import TIMEOUT as TIMEOUT
from .types import TRUE as TRUE
from .types import Body as Body
from .types import Law as Law
from .types import Plane as Plane
from .types import Precision as Precision
from .types import RoughLaw as RoughLaw
from .types import SmoothLaw as SmoothLaw
from .types import law_of as law_of
