"""replay.render."""

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
