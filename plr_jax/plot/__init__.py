"""Pictures, animations and web pages of PLRs, errors, workspaces, problems and paths.

Every ``plot_`` function draws on the given axes, or on a new figure, and returns the axes; :func:`save` writes the
picture. Functions of three or more dimensions are drawn on a slice, which ``at`` selects. :func:`animate` shows a
path in motion, and :func:`page` makes an interactive web page. Figures are made without pyplot, so no global state
changes.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
