"""Compiled kernels of the motion of a die: flight, impact, held contact, the event loop, and derivatives of them.

`flight` moves a free die to its first touch (`air`: with drag), `impact` has the impulse of every law, `friction_impulse` that of
Coulomb friction, `inertia` how dice answer an impulse and move without one, `held_contact` and `sliding_contact` follow lasting
contact, `rest` decides the end, `event_loop` runs a throw, and `log` records it. `types` has states, codes and constants. The
functions of `throw`, `laws` and `ensembles` call these kernels. A die with one moment of inertia is followed by the files of this
folder, any other by `asymmetric`; derivatives of both are in `derivatives`.
"""

from .air import Air as Air
from .air import Vacuum as Vacuum
from .air import drag_trajectory as drag_trajectory
from .air import slide_on_face as slide_on_face
from .event_loop import poses_of_throws as poses_of_throws
from .event_loop import run_throw as run_throw
from .flight import FallingDie as FallingDie
from .flight import advance as advance
from .flight import clearance as clearance
from .flight import first_touch as first_touch
from .flight import height_terms as height_terms
from .flight import lever_arm as lever_arm
from .flight import spin_rate as spin_rate
from .flight import table_height as table_height
from .flight import table_velocity as table_velocity
from .friction_impulse import coefficient_at_speed as coefficient_at_speed
from .friction_impulse import friction_impulse as friction_impulse
from .held_contact import contact_step as contact_step
from .held_contact import step_workspace as step_workspace
from .impact import impulse as impulse
from .inertia import EvenInertia as EvenInertia
from .inertia import TensorInertia as TensorInertia
from .inertia import contact_matrix as contact_matrix
from .inertia import move_freely as move_freely
from .inertia import spherical_contact_matrix as spherical_contact_matrix
from .rest import TIMEOUT as TIMEOUT
from .rest import decided_face as decided_face
from .rest import lowest_face_row as lowest_face_row
from .sliding_contact import FrictionalCorners as FrictionalCorners
from .sliding_contact import friction_step as friction_step
from .sliding_contact import inelastic_impulse as inelastic_impulse
from .types import ALGEBRAIC as ALGEBRAIC
from .types import BALANCED as BALANCED
from .types import CHATTER as CHATTER
from .types import COULOMB as COULOMB
from .types import COULOMB_BY_SPEED as COULOMB_BY_SPEED
from .types import COULOMB_FADING as COULOMB_FADING
from .types import FALSE as FALSE
from .types import FINE as FINE
from .types import IMPACT_CAP as IMPACT_CAP
from .types import IMPACTS_REACHED as IMPACTS_REACHED
from .types import LAW_CODES as LAW_CODES
from .types import LEVEL as LEVEL
from .types import NEWTON as NEWTON
from .types import NO_LIMIT as NO_LIMIT
from .types import POISSON as POISSON
from .types import RESTED as RESTED
from .types import SLIDING as SLIDING
from .types import SMOOTH as SMOOTH
from .types import SMOOTH_BY_SPEED as SMOOTH_BY_SPEED
from .types import SPINNING as SPINNING
from .types import STRONGE as STRONGE
from .types import TIME_REACHED as TIME_REACHED
from .types import TIMED_OUT as TIMED_OUT
from .types import TRUE as TRUE
from .types import AsymmetricBody as AsymmetricBody
from .types import Body as Body
from .types import Contact as Contact
from .types import Law as Law
from .types import Limits as Limits
from .types import Plane as Plane
from .types import PlaneInAir as PlaneInAir
from .types import Precision as Precision
from .types import RoughLaw as RoughLaw
from .types import Setup as Setup
from .types import SmoothLaw as SmoothLaw
from .types import law_of as law_of
