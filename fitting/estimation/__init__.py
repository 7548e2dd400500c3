"""Estimation: observations and their weights, robust least squares, and the intervals that follow.

`FlightObservations` are the usable frames of a track, each with the matrix that whitens its errors. `levenberg_marquardt` fits
them under bounds, with a loss that bad frames cannot bend (`huber`). `residual_errors` finds what the residuals show of the
frames and of the law, and `profile_interval` follows the likelihood of one parameter.
"""

from .intervals import normal_quantile as normal_quantile
from .intervals import profile_interval as profile_interval
from .least_squares import COARSE_TOLERANCE as COARSE_TOLERANCE
from .least_squares import COST_TOLERANCE as COST_TOLERANCE
from .least_squares import HUBER_THRESHOLD as HUBER_THRESHOLD
from .least_squares import MEDIAN_SQUARE as MEDIAN_SQUARE
from .least_squares import compressed as compressed
from .least_squares import covariance_of as covariance_of
from .least_squares import huber as huber
from .least_squares import levenberg_marquardt as levenberg_marquardt
from .least_squares import orthonormal_basis as orthonormal_basis
from .least_squares import robust_variance as robust_variance
from .least_squares import times_inverse as times_inverse
from .least_squares import triangular_factor as triangular_factor
from .observations import FlightObservations as FlightObservations
from .observations import flight_observations as flight_observations
from .observations import pose_errors as pose_errors
from .observations import whitened as whitened
from .observations import whitened_jacobian as whitened_jacobian
from .observations import whiteners as whiteners
from .observations import with_noise as with_noise
from .residual_errors import ResidualErrors as ResidualErrors
from .residual_errors import not_below as not_below
from .residual_errors import residual_errors as residual_errors
