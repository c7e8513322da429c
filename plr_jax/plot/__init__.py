"""Pictures, animations and web pages of PLRs, errors, workspaces, problems and paths.

Every ``plot_`` function draws on the given axes, or on a new figure, and returns the axes; :func:`save` writes the
picture. :func:`slices` draws functions of three or more dimensions, :func:`animate` shows a path in motion, and
:func:`page` makes an interactive web page. Figures are made without pyplot, so no global state changes.
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
