"""model.throw."""

from .asymmetric_throw import asymmetric_body_of as asymmetric_body_of
from .body import body_of as body_of
from .body import kernel_states as kernel_states
from .body import touching_vertices as touching_vertices
from .body import world_poses as world_poses
from .held_contact import HeldContact as HeldContact
from .motion import Flight as Flight
from .motion import Impact as Impact
from .motion import State as State
from .motion import Throw as Throw
from .motion import energy_J as energy_J
from .simulate import BOUNCING_CAP as BOUNCING_CAP
from .simulate import ENDINGS as ENDINGS
from .simulate import EXACT as EXACT
from .simulate import IMPACT_CAP as IMPACT_CAP
from .simulate import Ending as Ending
from .simulate import Precision as Precision
from .simulate import ThrowResult as ThrowResult
from .simulate import Until as Until
from .simulate import checked_release as checked_release
from .simulate import throw_die as throw_die
from .tangent import Propagation as Propagation
from .tangent import propagate as propagate
from .touch import packed_state as packed_state
from .touch import unpacked_state as unpacked_state
