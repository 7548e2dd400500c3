"""From the poses of single frames to a throw: flights, impacts and the end on the table.

Flights are proposed in two ways: a track is segmented wherever its motion changes (`flight_segmentation`), and followed from one
contact to the next (`contact_search`). `contacts` fits each proposal as a chain of `flights`, decides which contacts are real
(`contact_clusters`: those within a few frames), and which proposal explains the frames better. The errors common to all
frames are estimated on the way (`shared_bias`; those of cameras, die and clock: `calibration_errors`), and the end during which
the table supports the die is set aside (`rest`). `measure` returns all of that; `measure_throw` the throw alone. Tracking uses
these flights to refine poses and to calibrate covariances (`with_calibrated_covariance`), commands to smooth the track
(`smoothing`), fitting as measured throws."""

from .calibration_errors import CAMERA_ERRORS as CAMERA_ERRORS
from .calibration_errors import CENTRE_SIGMA_PX as CENTRE_SIGMA_PX
from .calibration_errors import CLOCK_SHARE as CLOCK_SHARE
from .calibration_errors import EDGE_SHARE as EDGE_SHARE
from .calibration_errors import FOCAL_SHARE as FOCAL_SHARE
from .calibration_errors import PLACE_SIGMA_M as PLACE_SIGMA_M
from .calibration_errors import TURN_SIGMA_RAD as TURN_SIGMA_RAD
from .calibration_errors import CalibrationErrors as CalibrationErrors
from .calibration_errors import displaced as displaced
from .calibration_errors import usual_covariance as usual_covariance
from .contacts import PENALTY as PENALTY
from .contacts import gain_over as gain_over
from .flight_segmentation import ENOUGH_FRAMES as ENOUGH_FRAMES
from .flight_segmentation import SMALL_MOVE_REACH as SMALL_MOVE_REACH
from .flight_segmentation import SMALL_TURN_RAD as SMALL_TURN_RAD
from .flight_segmentation import contact_reach_m as contact_reach_m
from .flight_segmentation import decimation_factor as decimation_factor
from .flight_segmentation import rows_without_outliers as rows_without_outliers
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
from .shared_bias import placement_covariances as placement_covariances
from .shared_bias import shared_bias_jacobian as shared_bias_jacobian
from .shared_bias import without_shared_bias as without_shared_bias
from .smoothing import smooth as smooth
