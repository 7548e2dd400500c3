"""The rigid-impact model of a thrown die: exact flight, impacts, held contact, and throws simulated event by event.

    die = make_die("cube", edge_m=0.02, mass_kg=0.016)
    result = throw_die(die, release, SmoothImpact(chi=0.5))

- `die`: what a die is: its solid, mass, inertia, rounded corners and symmetries.
- `laws`: impact laws, and the table.
- `throw`: the values of a throw, its simulation from release to rest, and its derivatives.
- `ensembles`: many throws (odds, basins, predictability), and the growth of errors in one (chaos).
- `engine`: the compiled kernels below them, on plain numbers and arrays.

Beside these, `rotations` has the quaternions, `world` the acceleration of gravity, `compiled` how kernels are compiled, and
`kernel_cache` when they are compiled again. The model does not use footage; tracking and fitting import it.
"""

from .die import Die as Die
from .die import Solid as Solid
from .die import convex_solid as convex_solid
from .die import die_from_solid as die_from_solid
from .die import loaded_die as loaded_die
from .die import make_die as make_die
from .die import truncated_dipyramid as truncated_dipyramid
from .laws import CoulombImpact as CoulombImpact
from .laws import FrictionBySpeed as FrictionBySpeed
from .laws import ImpactLaw as ImpactLaw
from .laws import RestitutionBySpeed as RestitutionBySpeed
from .laws import SmoothImpact as SmoothImpact
from .laws import Table as Table
from .throw import Ending as Ending
from .throw import Flight as Flight
from .throw import Impact as Impact
from .throw import Precision as Precision
from .throw import State as State
from .throw import Throw as Throw
from .throw import ThrowResult as ThrowResult
from .throw import Until as Until
from .throw import throw_die as throw_die
