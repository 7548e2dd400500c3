"""Derivatives of throws: the growth of errors, what double precision decides, and a throw with derivatives for fits.

`impulse_gradient` has the derivatives of an impulse, for every law and dice of any inertia, `linearised_motion` carries
derivatives along a flight and across an impact (`saltation`), `throw_tangent` along a prescribed throw, `growth` along a
simulated one, and `decidability` compares them with rounding errors. `ensembles.chaos` uses `run_growth`, `run_exponents` and
`decide`; `throw.tangent`, and so every fit, uses `run_tangent`.
"""

from .decidability import decide as decide
from .decidability import decide_many as decide_many
from .growth import displaced as displaced
from .growth import run_exponents as run_exponents
from .growth import run_growth as run_growth
from .growth import scales_of as scales_of
from .impulse_gradient import ASYMMETRIC_INPUTS as ASYMMETRIC_INPUTS
from .impulse_gradient import INPUTS as INPUTS
from .impulse_gradient import MATRIX_CHANGES as MATRIX_CHANGES
from .impulse_gradient import ParameterDerivatives as ParameterDerivatives
from .impulse_gradient import impulse_gradient as impulse_gradient
from .linearised_motion import SHIFTS as SHIFTS
from .linearised_motion import Impact as Impact
from .linearised_motion import ImpactDerivatives as ImpactDerivatives
from .linearised_motion import ImpactKinematics as ImpactKinematics
from .linearised_motion import impact_derivatives as impact_derivatives
from .linearised_motion import saltation as saltation
from .linearised_motion import shifts_at_impact as shifts_at_impact
from .throw_tangent import ImpactSequence as ImpactSequence
from .throw_tangent import run_tangent as run_tangent
