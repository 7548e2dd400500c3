"""Rendering: a camera's view of a simulated throw, path-traced with Mitsuba 3, and the sensor that records it.

`FilmRenderer` returns the light on the sensor, with motion blur, rolling shutter, depth of field, lens distortion, shadows and
mirror images; `expose` turns it into grey levels with noise. `Processor` does to frames what cameras do, `shown_pictures` spoils
their order, and `write_film` stores them. The command `film` writes clips with all of it, and tests and benchmarks make footage.
"""

from .camera_processing import Processing as Processing
from .camera_processing import Processor as Processor
from .camera_processing import filtered as filtered
from .camera_processing import gains as gains
from .camera_processing import shifts_px as shifts_px
from .film_file import CODECS as CODECS
from .film_file import Codec as Codec
from .film_file import write_film as write_film
from .frame_faults import FrameFaults as FrameFaults
from .frame_faults import shown_pictures as shown_pictures
from .lens import Aperture as Aperture
from .mitsuba_scene import Appearance as Appearance
from .mitsuba_scene import lamp_beside as lamp_beside
from .renderer import FilmRenderer as FilmRenderer
from .renderer import RenderSettings as RenderSettings
from .renderer import frame_light as frame_light
from .sensor import FixedPattern as FixedPattern
from .sensor import Sensor as Sensor
from .sensor import expose as expose
from .sensor import fixed_pattern as fixed_pattern
from .sensor import rounded as rounded
from .shutter import Shutter as Shutter
