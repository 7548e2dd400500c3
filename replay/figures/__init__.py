"""replay.figures."""

from .exponents import convergence as convergence
from .exponents import growth_curve as growth_curve
from .maps import ball_measures as ball_measures
from .maps import basin_map as basin_map
from .maps import colours_of as colours_of
from .maps import face_odds as face_odds
from .maps import lowest_again as lowest_again
from .maps import uncertain_shares as uncertain_shares
from .multiple_exposure import COLUMNS as COLUMNS
from .multiple_exposure import bounce_strip as bounce_strip
from .multiple_exposure import rows_of_strip as rows_of_strip
from .multiple_exposure import stroboscope as stroboscope
from .throw_figures import corner_heights as corner_heights
from .throw_figures import throw_heights as throw_heights
