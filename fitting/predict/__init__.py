"""Predictions: the state from the frames before some instant, and what the model makes of it.

`release_before` estimates the state, `predict_track` simulates from it, `with_covariances`
says how far off its poses may be, `decide` gives the face odds bounce by bounce.
`sequential_estimates` shows how a fit becomes more certain with every bounce. Joint fits rest on `simulated_packed`.
"""

from .pose_errors import with_covariances as with_covariances
from .prediction import DRAWS as DRAWS
from .prediction import Decision as Decision
from .prediction import FaceOdds as FaceOdds
from .prediction import decide as decide
from .prediction import predict_track as predict_track
from .prediction import simulated_packed as simulated_packed
from .prediction import simulated_throws as simulated_throws
from .release_state import MIN_FLIGHT_FRAMES as MIN_FLIGHT_FRAMES
from .release_state import ReleaseState as ReleaseState
from .release_state import first_bounce_row as first_bounce_row
from .release_state import flight_length as flight_length
from .release_state import release_before as release_before
from .release_state import usable_rows as usable_rows
from .sequential import Estimate as Estimate
from .sequential import sequential_estimates as sequential_estimates
