"""model.engine.derivatives."""

from .growth import displaced as displaced
from .growth import run_exponents as run_exponents
from .growth import run_growth as run_growth
from .growth import scales_of as scales_of
from .rounding import decide as decide
from .rounding import decide_many as decide_many
from .throw_tangent import run_tangent as run_tangent
