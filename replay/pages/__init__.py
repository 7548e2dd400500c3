"""Pages: self-contained HTML that needs no network.

The report of an analysed throw, the page of a simulated one, of a check, of a calibration and of a comparison of settings
(trade). A page contains its figures and, if asked for, the Rerun viewer with the recording. Commands write these pages.
"""

from ..elements import ReportDetails as ReportDetails
from .calibration import calibration_page as calibration_page
from .captioned_figures import report_figures as report_figures
from .captioned_figures import write_figures as write_figures
from .check import check_page as check_page
from .page_parts import STYLE as STYLE
from .page_parts import whole_page as whole_page
from .report import throw_page as throw_page
from .report import write_report as write_report
from .trade import Setting as Setting
from .trade import Trade as Trade
from .trade import fastest_within as fastest_within
from .trade import trade_page as trade_page
from .trade import write_trade_figures as write_trade_figures
