"""What the figures show, as arrays: result -> NamedTuples, nothing is drawn here."""

from tirefit.report.curves import Curve, FitCurve, Group, fit_curve
from tirefit.report.residuals import Residuals, Scatter, residual_panels
from tirefit.report.uncertainty import (
    Corner,
    ProfilePanel,
    Trace,
    corner_data,
    profile_data,
    trace_data,
)

__all__ = [
    "Corner",
    "Curve",
    "FitCurve",
    "Group",
    "ProfilePanel",
    "Residuals",
    "Scatter",
    "Trace",
    "corner_data",
    "fit_curve",
    "profile_data",
    "residual_panels",
    "trace_data",
]
