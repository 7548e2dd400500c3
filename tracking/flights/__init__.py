"""Exact motion fitted to the poses of many frames: one flight, and flights joined by impacts.

`single_flights` has the motion of one flight, its derivatives, and the errors of frames, correlated and shared; `flight_chain`
fits flights joined by impacts together, solved link by link (`chain_solver`); `error_model` estimates how large and how long
correlated the errors of the frames are. Which flights there are, and what joins them, is found in `throw`."""

from .error_model import error_model_of as error_model_of
from .error_model import estimate_error_model as estimate_error_model
from .flight_chain import CONTACT_SIGMA_M as CONTACT_SIGMA_M
from .flight_chain import CUTOFF_SIGMAS as CUTOFF_SIGMAS
from .flight_chain import JOINT as JOINT
from .flight_chain import TABLE_SIGMA_M as TABLE_SIGMA_M
from .flight_chain import FlightChain as FlightChain
from .flight_chain import Link as Link
from .flight_chain import VertexImpact as VertexImpact
from .flight_chain import fit_chain as fit_chain
from .flight_chain import vertex_impact_cost as vertex_impact_cost
from .flight_chain import vertex_impact_equations as vertex_impact_equations
from .single_flights import ErrorModel as ErrorModel
from .single_flights import WeightedPoses as WeightedPoses
from .single_flights import chain_residuals as chain_residuals
from .single_flights import fit_flight as fit_flight
from .single_flights import fit_flights as fit_flights
from .single_flights import fit_states as fit_states
from .single_flights import flight_residuals as flight_residuals
from .single_flights import left_jacobians as left_jacobians
from .single_flights import packed as packed
from .single_flights import perturbed as perturbed
from .single_flights import pose_jacobian as pose_jacobian
from .single_flights import rms_residuals as rms_residuals
from .single_flights import spin_rates as spin_rates
from .single_flights import transition_matrices as transition_matrices
from .single_flights import transition_matrix as transition_matrix
from .single_flights import unpacked as unpacked
