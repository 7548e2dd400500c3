"""replay.figures."""

from . import throw_plots as throw_plots
from .clip_frames import COLUMNS as COLUMNS
from .clip_frames import bounce_strip as bounce_strip
from .clip_frames import rows_of_strip as rows_of_strip
from .clip_frames import stroboscope as stroboscope
from .ensembles import ball_measures as ball_measures
from .ensembles import basin_map as basin_map
from .ensembles import colours_of as colours_of
from .ensembles import face_odds as face_odds
from .ensembles import lowest_again as lowest_again
from .ensembles import uncertain_shares as uncertain_shares
from .exponents import convergence as convergence
from .exponents import growth_curve as growth_curve
from .throw_plots import corner_heights as corner_heights
from .throw_plots import throw_heights as throw_heights
