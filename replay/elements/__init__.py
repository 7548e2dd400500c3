"""What all replays share: the record that they draw, colours, edges in view, findings as text, and the clip as video.

`Record` is the input of every recording, figure and report. `Motion` is one throw (measured or simulated) ready to draw.
Recordings, figures and pages take their colours and their sentences from here, so that all of them agree.
"""

from .colours import ALARM as ALARM
from .colours import AXIS_COLOURS as AXIS_COLOURS
from .colours import BLACK as BLACK
from .colours import BOUNCING_COLOUR as BOUNCING_COLOUR
from .colours import COLOURS as COLOURS
from .colours import FACE_COLOURS as FACE_COLOURS
from .colours import GRID as GRID
from .colours import IMPACT as IMPACT
from .colours import MEASURED as MEASURED
from .colours import NO_RELEASE_COLOUR as NO_RELEASE_COLOUR
from .colours import SIMULATED as SIMULATED
from .colours import SPINNING_COLOUR as SPINNING_COLOUR
from .colours import TABLE as TABLE
from .colours import THROW_COLOURS as THROW_COLOURS
from .colours import WHITE as WHITE
from .colours import Colour as Colour
from .colours import hex_colour as hex_colour
from .colours import mixed as mixed
from .edges_in_view import POINTS_PER_EDGE as POINTS_PER_EDGE
from .edges_in_view import VisibleEdges as VisibleEdges
from .edges_in_view import visible_edges as visible_edges
from .findings_text import UNKNOWN as UNKNOWN
from .findings_text import bounce_sentence as bounce_sentence
from .findings_text import certainty_sentences as certainty_sentences
from .findings_text import chi_of as chi_of
from .findings_text import count_word as count_word
from .findings_text import decimals_for as decimals_for
from .findings_text import effects_sentences as effects_sentences
from .findings_text import estimate_sentence as estimate_sentence
from .findings_text import fixed as fixed
from .findings_text import impulse_of as impulse_of
from .findings_text import interval as interval
from .findings_text import landing_sentence as landing_sentence
from .findings_text import markdown as markdown
from .findings_text import number as number
from .findings_text import parameter_text as parameter_text
from .findings_text import plural as plural
from .findings_text import role as role
from .findings_text import short_interval as short_interval
from .findings_text import short_verdict as short_verdict
from .findings_text import verdict as verdict
from .record import Motion as Motion
from .record import Record as Record
from .record import ReportDetails as ReportDetails
from .record import Residuals as Residuals
from .record import motion_of as motion_of
from .record import motions_of as motions_of
from .record import residuals as residuals
from .record import track_of as track_of
from .video import VideoEncoding as VideoEncoding
from .video import Window as Window
from .video import can_encode_av1 as can_encode_av1
from .video import display_window as display_window
from .video import encode_av1 as encode_av1
from .video import encode_jpegs as encode_jpegs
from .video import shown_rows as shown_rows
