"""model.die."""

from .die import MAX_CORNER_RADIUS_FRACTION as MAX_CORNER_RADIUS_FRACTION
from .die import Die as Die
from .die import die_from_solid as die_from_solid
from .die import loaded_die as loaded_die
from .die import make_die as make_die
from .solid import SHAPES as SHAPES
from .solid import Solid as Solid
from .solid import convex_solid as convex_solid
from .solid import inner_vertices as inner_vertices
from .solid import lowest_face as lowest_face
from .solid import numbered_solid as numbered_solid
from .solid import truncated_dipyramid as truncated_dipyramid
from .symmetry import die_symmetries as die_symmetries
from .symmetry import inversion_rotation as inversion_rotation
from .symmetry import nearest_equivalent_rotation as nearest_equivalent_rotation
from .symmetry import symmetry_rotations as symmetry_rotations
