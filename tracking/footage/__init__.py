"""Clips of any format as grey frames with their times, behind one interface.

One reader a format: video containers, numbered pictures and TIFF, Photron and Phantom. `open_clip` chooses the reader by the
content of the file. `FrameSource` hands out blocks of frames of synchronised cameras, read ahead; `Decimation` leaves out
frames or makes the pictures smaller; `clip_in_light` undoes a display curve; `clip_without_mosaic` smooths a raw mosaic; the
background is read or estimated. All other folders read pictures through this one.
"""

from .background import estimate_background as estimate_background
from .background import load_background as load_background
from .background import shows_one_picture as shows_one_picture
from .cine import is_cine as is_cine
from .clip import Clip as Clip
from .clip import DerivedClip as DerivedClip
from .clip import FillingDerivedClip as FillingDerivedClip
from .clip import FillsFrames as FillsFrames
from .clip import clip_files as clip_files
from .clip import open_clip as open_clip
from .decimation import WHOLE_CLIP as WHOLE_CLIP
from .decimation import Decimation as Decimation
from .frame_blocks import FrameBlock as FrameBlock
from .frame_blocks import Frames as Frames
from .frame_blocks import FrameSource as FrameSource
from .frame_blocks import Rows as Rows
from .images import PICTURE_SUFFIXES as PICTURE_SUFFIXES
from .images import read_picture as read_picture
from .mosaic import clip_without_mosaic as clip_without_mosaic
from .mosaic import has_mosaic as has_mosaic
from .mosaic import mosaic_of as mosaic_of
from .mosaic import smoothed as smoothed
from .photron import is_photron as is_photron
from .reader import AS_STORED as AS_STORED
from .reader import MAX_PIXELS as MAX_PIXELS
from .reader import MOSAIC as MOSAIC
from .reader import REPEATED as REPEATED
from .reader import TURNED as TURNED
from .reader import Frame as Frame
from .response import EXPONENTS as EXPONENTS
from .response import NAMED_RESPONSES as NAMED_RESPONSES
from .response import Response as Response
from .response import clip_in_light as clip_in_light
from .response import grey_of as grey_of
from .response import is_linear as is_linear
from .response import level_grey as level_grey
from .response import picture_in_light as picture_in_light
