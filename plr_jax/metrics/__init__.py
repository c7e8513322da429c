"""How far an approximation of a distance function is from it: in value, and in the direction of its gradient."""

from plr_jax.metrics._error import ErrorReport, error_grid, error_map
from plr_jax.metrics._gradient import GradientReport, JumpReport, WalkReport, gradient_report

__all__ = [
    "ErrorReport",
    "GradientReport",
    "JumpReport",
    "WalkReport",
    "error_grid",
    "error_map",
    "gradient_report",
]
