"""One throw: its values, its simulation from release to rest, and its derivatives.

`State`, `Flight`, `Impact` and `Throw` are the values that every stage shares, whether a throw was measured or
simulated. `throw_die` follows a die event by event. `propagate` gives the poses of a throw with their derivatives by
its start and by parameters of die, law and table, for fits. `body_of` and the packed states are for callers of
`model.engine`.
"""

from .asymmetric_throw import throw_asymmetric_die as throw_asymmetric_die
from .body import MAX_STATE_COMPONENT as MAX_STATE_COMPONENT
from .body import RELEASE_DEPTH_TOLERANCE as RELEASE_DEPTH_TOLERANCE
from .body import asymmetric_body_of as asymmetric_body_of
from .body import body_of as body_of
from .body import checked_release as checked_release
from .body import kernel_states as kernel_states
from .body import packed_state as packed_state
from .body import touching_vertices as touching_vertices
from .body import unpacked_state as unpacked_state
from .body import world_poses as world_poses
from .held_contact import HeldContact as HeldContact
from .history import free_flight as free_flight
from .motion import EVEN as EVEN
from .motion import Flight as Flight
from .motion import Impact as Impact
from .motion import State as State
from .motion import Throw as Throw
from .motion import Turning as Turning
from .motion import energy_J as energy_J
from .motion import rotated_state as rotated_state
from .motion import turning_of as turning_of
from .motion import turns_in_flight as turns_in_flight
from .simulate import BOUNCING_CAP as BOUNCING_CAP
from .simulate import ENDINGS as ENDINGS
from .simulate import EXACT as EXACT
from .simulate import IMPACT_CAP as IMPACT_CAP
from .simulate import Ending as Ending
from .simulate import Precision as Precision
from .simulate import ThrowResult as ThrowResult
from .simulate import Until as Until
from .simulate import is_endless as is_endless
from .simulate import throw_die as throw_die
from .supported import SUPPORTED as SUPPORTED
from .supported import Action as Action
from .supported import BodyKind as BodyKind
from .supported import Door as Door
from .supported import body_kind as body_kind
from .supported import needs_asymmetric_kernels as needs_asymmetric_kernels
from .supported import refuse_unsupported as refuse_unsupported
from .supported import support_table as support_table
from .tangent import Propagation as Propagation
from .tangent import propagate as propagate
