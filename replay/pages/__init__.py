"""replay.pages."""

from .account import ReportDetails as ReportDetails
from .calibration import calibration_page as calibration_page
from .captioned_figures import write_figures as write_figures
from .check import check_page as check_page
from .page_parts import STYLE as STYLE
from .report import write_report as write_report
from .throw import throw_page as throw_page
from .trade import Setting as Setting
from .trade import Trade as Trade
from .trade import fastest_within as fastest_within
from .trade import trade_page as trade_page
from .trade import write_trade_figures as write_trade_figures
