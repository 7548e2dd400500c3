"""tracking.calibration."""

from .boards import Board as Board
from .boards import BoardView as BoardView
from .boards import eight_bits as eight_bits
from .boards import find_boards as find_boards
from .boards import make_board as make_board
from .intrinsics import INTRINSICS as INTRINSICS
from .intrinsics import Calibration as Calibration
from .intrinsics import SeenBoard as SeenBoard
from .intrinsics import calibrate as calibrate
from .table_board import TablePose as TablePose
from .table_board import table_pose as table_pose
