"""Pictures of piecewise linear regressions, their errors, workspaces, problems, and paths, still or in motion.

Every ``plot_`` function draws on the axes it is given, or on a new figure of its own, and returns the axes;
:func:`save` writes the picture. :func:`animate` sets a path in motion. Figures are made without pyplot, so no
global state changes. They have an opaque white page with dark ink, which stays legible when the picture is set into
a dark page, and use colors that color-blind readers can tell apart.
"""

from plr_jax.plot._animation import Animation as Animation
from plr_jax.plot._animation import animate as animate
from plr_jax.plot._page import save as save
from plr_jax.plot._paths import plot_path as plot_path
from plr_jax.plot._paths import plot_problem as plot_problem
from plr_jax.plot._paths import plot_samples as plot_samples
from plr_jax.plot._plane import plot_cells as plot_cells
from plr_jax.plot._plane import plot_contours as plot_contours
from plr_jax.plot._plane import plot_error as plot_error
from plr_jax.plot._plane import plot_workspace as plot_workspace
from plr_jax.plot._surface import plot_surface as plot_surface
