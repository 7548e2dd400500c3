"""Poses from the surface marks of a die: pips, numbers, grain, whatever its flat faces show.

`learn_marks` learns the textures of the faces from frames of a first track and adjusts the flights together with
them. `FrameRefinement` then refines single frames on marks and edges; the passes of `sequence` use both. `read_faces`
reads the numbers on the learned textures, from which the commands label the faces.
"""

from .bundle_adjustment import CHI2_MEDIAN as CHI2_MEDIAN
from .bundle_adjustment import common_length_m as common_length_m
from .bundle_adjustment import contour_covariance as contour_covariance
from .bundle_adjustment import median_square as median_square
from .face_numbers import FaceNumbers as FaceNumbers
from .face_numbers import read_faces as read_faces
from .face_numbers import with_numbers as with_numbers
from .learning import frames_to_learn_from as frames_to_learn_from
from .learning import labels_by_marks as labels_by_marks
from .learning import learn_marks as learn_marks
from .pose_refinement import FramePoses as FramePoses
from .pose_refinement import FrameRefinement as FrameRefinement
from .textures import SurfaceMarks as SurfaceMarks
