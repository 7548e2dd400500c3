"""fitting.estimation."""

from .intervals import correlation_length as correlation_length
from .intervals import profile_interval as profile_interval
from .intervals import variance_inflation as variance_inflation
from .least_squares import ENOUGH as ENOUGH
from .least_squares import NEARLY as NEARLY
from .least_squares import descend as descend
from .observations import Sightings as Sightings
from .observations import cross_matrices as cross_matrices
from .observations import pose_errors as pose_errors
from .observations import sight as sight
from .observations import whitened as whitened
from .observations import whitened_jacobian as whitened_jacobian
from .observations import whiteners as whiteners
from .observations import with_noise as with_noise
from .robust import CLEAN_FRAME as CLEAN_FRAME
from .robust import MEDIAN_FRAME as MEDIAN_FRAME
from .robust import condensed as condensed
from .robust import huber as huber
from .robust import in_units_of as in_units_of
from .robust import orthonormal as orthonormal
from .robust import robust_variance as robust_variance
from .robust import triangle as triangle
