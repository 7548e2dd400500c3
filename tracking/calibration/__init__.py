"""A camera's intrinsics, distortion and place over the table, from pictures of a board, with their covariances.

`boards` finds the corners of a board on pictures, `intrinsics` fits the camera to them, and `table_board` finds the world's
axes from a board on the table. `diethrow calibrate` and its page use them; tracking takes the `Camera` that results.
"""

from .boards import Board as Board
from .boards import BoardView as BoardView
from .boards import eight_bits as eight_bits
from .boards import find_boards as find_boards
from .boards import make_board as make_board
from .intrinsics import INTRINSICS as INTRINSICS
from .intrinsics import Calibration as Calibration
from .intrinsics import PosedBoard as PosedBoard
from .intrinsics import calibrate as calibrate
from .table_board import JOINT as JOINT
from .table_board import TablePose as TablePose
from .table_board import table_pose as table_pose
