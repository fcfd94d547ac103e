"""Calibration of industrial robots with a telescoping double ball-bar.

Arrays in, arrays out: N x 6 axis angles of the controller, one row a pose. A name says its angles: ``_deg`` degrees,
``_rad`` radians. Lengths are mm. What fails raises :class:`DbbdError` with the code and the text of the command line; a warning
about a file is a :class:`DbbdWarning`.
"""

from ._dbbd import Capture, Check, Plan, Result, Robot, __version__, check, identify, plan, request, request_json, simulate
from ._error import DbbdError, DbbdWarning

__all__ = [
    "Capture",
    "Check",
    "DbbdError",
    "DbbdWarning",
    "Plan",
    "Result",
    "Robot",
    "__version__",
    "check",
    "identify",
    "plan",
    "request",
    "request_json",
    "simulate",
]
