"""Figures: one function per picture, drawn on the axes it is given.

Plots of one throw (heights, residuals, restitution, odds), images made of frames of its clip (multiple exposure, strips of
bounces), and plots of many throws (basins, odds, predictability, exponents). Pages and commands arrange and save them.
"""

from . import throw_plots as throw_plots
from .clip_frames import COLUMNS as COLUMNS
from .clip_frames import bounce_strip as bounce_strip
from .clip_frames import edges_on_frame as edges_on_frame
from .clip_frames import rows_of_strip as rows_of_strip
from .clip_frames import stroboscope as stroboscope
from .ensembles import ball_measures as ball_measures
from .ensembles import basin_map as basin_map
from .ensembles import colours_of as colours_of
from .ensembles import convergence as convergence
from .ensembles import face_odds as face_odds
from .ensembles import growth_curve as growth_curve
from .ensembles import lowest_again as lowest_again
from .ensembles import uncertain_shares as uncertain_shares
from .plot_axes import PlotAxes as PlotAxes
from .throw_plots import AXIS_GREY as AXIS_GREY
from .throw_plots import angle_residuals as angle_residuals
from .throw_plots import corner_heights as corner_heights
from .throw_plots import correlations as correlations
from .throw_plots import correlations_of as correlations_of
from .throw_plots import landing_odds as landing_odds
from .throw_plots import legend_above as legend_above
from .throw_plots import odds_over_time as odds_over_time
from .throw_plots import position_residuals as position_residuals
from .throw_plots import position_sigmas as position_sigmas
from .throw_plots import remove_box as remove_box
from .throw_plots import restitution as restitution
from .throw_plots import throw_heights as throw_heights
from .throw_plots import turn_sigmas as turn_sigmas
