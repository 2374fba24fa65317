"""What a person sees of a run: the HTML report and the picture made from a run directory.

`write_report` writes one self-contained page, `write_still` one stroboscopic picture. Both read the run directory
only, never the twin or the controller that made it, so that a report can be made again from what was kept.
"""

from softbot.report.page import write_report
from softbot.report.still import write_still

__all__ = ["write_report", "write_still"]
