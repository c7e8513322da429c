"""Pictures of piecewise linear regressions, their errors, workspaces, problems, and paths, still or in motion.

Every ``plot_`` function draws on the axes it is given, or on a new figure of its own, and returns the axes;
:func:`save` writes the picture. :func:`slices` draws functions of three or more dimensions in a figure of their own,
and :func:`animate` sets a path in motion. :func:`page` makes a page of a distance function, which can be asked.
Figures are made without pyplot, so no global state changes. They have an opaque white page with dark ink, which stays
legible when the picture is set into a dark page, and use colors that color-blind readers can tell apart.
"""

from plr_jax.plot._animation import Animation, animate
from plr_jax.plot._axes import save
from plr_jax.plot._page import Page, page
from plr_jax.plot._paths import plot_path, plot_problem, plot_samples
from plr_jax.plot._plane import plot_cells, plot_contours, plot_error, plot_surface, plot_workspace
from plr_jax.plot._slices import slices

__all__ = [
    "Animation",
    "Page",
    "animate",
    "page",
    "plot_cells",
    "plot_contours",
    "plot_error",
    "plot_path",
    "plot_problem",
    "plot_samples",
    "plot_surface",
    "plot_workspace",
    "save",
    "slices",
]
