"""Rendering: a camera's view of a simulated throw, path-traced with Mitsuba 3, and the sensor that records it.

`FilmRenderer` returns the light on the sensor, with motion blur, lens distortion, shadows and mirror images; `expose` turns
it into grey levels with noise. The command `film` writes clips with it, and tests and benchmarks make footage.
"""

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
