"""Plots as SVG that stands in the page itself: text that can be selected, and a tenth of a second for a report.

`SvgAxes` has those methods of matplotlib's axes that the figures use, so that one description of a figure draws on either.
matplotlib takes longer to import than this needs for all figures of a report.
"""

from .axes import SvgAxes as SvgAxes
from .elements import INK as INK
from .elements import LINE_GREY as LINE_GREY
