"""What a die strikes, and what the table does to it: the impact laws, and the table.

`SmoothImpact` is the law of Kapitaniak et al. (2012) and the fastest. `CoulombImpact` adds friction and takes two to
four microseconds an impact. `RestitutionBySpeed` and `FrictionBySpeed` let the coefficients of either fall as impacts
get faster. `Table` is level and at rest, tilted, or oscillating along its normal. A law is a value with two properties
(`ImpactLaw`); the compiled kernels that compute the impulse are in `model.engine`.
"""

from .coulomb import CoulombImpact as CoulombImpact
from .coulomb import Restitution as Restitution
from .fading import FrictionBySpeed as FrictionBySpeed
from .fading import RestitutionBySpeed as RestitutionBySpeed
from .impact_law import ImpactLaw as ImpactLaw
from .smooth import SmoothImpact as SmoothImpact
from .table import LEVEL as LEVEL
from .table import MAX_DRAG_PER_M as MAX_DRAG_PER_M
from .table import Table as Table
from .table import checked_drag as checked_drag
