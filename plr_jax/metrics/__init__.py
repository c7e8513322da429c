"""How far an approximation of a distance function is from it: in value, and in the direction of its gradient."""

from plr_jax.metrics._error import ErrorReport as ErrorReport
from plr_jax.metrics._error import error_grid as error_grid
from plr_jax.metrics._error import error_map as error_map
from plr_jax.metrics._gradient import GradientReport as GradientReport
from plr_jax.metrics._gradient import JumpReport as JumpReport
from plr_jax.metrics._gradient import WalkReport as WalkReport
from plr_jax.metrics._gradient import gradient_report as gradient_report
