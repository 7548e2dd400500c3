"""tracking.surface_marks."""

from .bundle_adjustment import CHI2_MEDIAN as CHI2_MEDIAN
from .face_numbers import FaceNumbers as FaceNumbers
from .face_numbers import read_faces as read_faces
from .face_numbers import with_numbers as with_numbers
from .learning import FramePoses as FramePoses
from .learning import Refining as Refining
from .learning import frames_to_learn_from as frames_to_learn_from
from .learning import learn_marks as learn_marks
from .textures import Marks as Marks
