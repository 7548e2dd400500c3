"""From the poses of single frames to a throw: flights, impacts and the end on the table.

A track is segmented into flights (`flight_segmentation`), neighbouring flights are joined by impacts and fitted together
(`flights`, `flight_chain`, `chain_solver`), `contacts` decides which of them are real and which are spurious
(`contact_clusters`: those within a few frames), the error model and the errors common to all frames are estimated
(`error_model`, `shared_bias`), and the end during which the table supports the die is set aside (`rest`). `measure` returns
all of that; `measure_throw` the throw alone. Tracking uses these flights to refine poses and to calibrate covariances
(`with_calibrated_covariance`), commands to smooth the track (`smoothing`), fitting as measured throws."""

from .flight_chain import CONTACT_SIGMA_M as CONTACT_SIGMA_M
from .flight_chain import TABLE_SIGMA_M as TABLE_SIGMA_M
from .flight_chain import VertexImpact as VertexImpact
from .flight_chain import vertex_impact_equations as vertex_impact_equations
from .flight_segmentation import ENOUGH_FRAMES as ENOUGH_FRAMES
from .flight_segmentation import SMALL_MOVE_REACH as SMALL_MOVE_REACH
from .flight_segmentation import SMALL_TURN_RAD as SMALL_TURN_RAD
from .flight_segmentation import TABLE_REACH as TABLE_REACH
from .flight_segmentation import decimation_factor as decimation_factor
from .flight_segmentation import rows_without_outliers as rows_without_outliers
from .flights import WeightedPoses as WeightedPoses
from .flights import fit_flights as fit_flights
from .flights import fit_states as fit_states
from .flights import left_jacobians as left_jacobians
from .flights import perturbed as perturbed
from .flights import pose_jacobian as pose_jacobian
from .flights import transition_matrices as transition_matrices
from .flights import transition_matrix as transition_matrix
from .measurement import OFF_FLIGHT_RAD as OFF_FLIGHT_RAD
from .measurement import UNMODELLED_SHARE as UNMODELLED_SHARE
from .measurement import MeasuredThrow as MeasuredThrow
from .measurement import NoFlightError as NoFlightError
from .measurement import determines_table_height as determines_table_height
from .measurement import measure as measure
from .measurement import measure_throw as measure_throw
from .measurement import weighted_poses as weighted_poses
from .measurement import with_calibrated_covariance as with_calibrated_covariance
from .rest import SupportedMotion as SupportedMotion
from .rest import first_supported_row as first_supported_row
from .rest import flights_only as flights_only
from .rest import frames_in_flight as frames_in_flight
from .rest import lowest_heights_m as lowest_heights_m
from .shared_bias import CONTOUR_SHARE as CONTOUR_SHARE
from .shared_bias import CONTOUR_SIGMA_PX as CONTOUR_SIGMA_PX
from .shared_bias import LATERAL_SHARE as LATERAL_SHARE
from .shared_bias import outline_growth as outline_growth
from .shared_bias import shared_bias_jacobian as shared_bias_jacobian
from .shared_bias import without_shared_bias as without_shared_bias
