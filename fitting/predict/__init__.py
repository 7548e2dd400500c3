"""fitting.predict."""

from .prediction import DRAWS as DRAWS
from .prediction import Decision as Decision
from .prediction import Odds as Odds
from .prediction import decided_at as decided_at
from .prediction import foretell as foretell
from .prediction import simulated_throws as simulated_throws
from .release_state import FEWEST as FEWEST
from .release_state import Outset as Outset
from .release_state import first_bounce_row as first_bounce_row
from .release_state import flight_length as flight_length
from .release_state import outset_before as outset_before
from .release_state import usable_rows as usable_rows
from .sequential import Estimate as Estimate
from .sequential import estimates as estimates
