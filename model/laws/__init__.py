"""model.laws."""

from .impact_laws import Array as Array
from .impact_laws import CoulombImpact as CoulombImpact
from .impact_laws import FrictionBySpeed as FrictionBySpeed
from .impact_laws import ImpactLaw as ImpactLaw
from .impact_laws import Restitution as Restitution
from .impact_laws import RestitutionBySpeed as RestitutionBySpeed
from .impact_laws import SmoothImpact as SmoothImpact
from .tables import LEVEL as LEVEL
from .tables import Table as Table
