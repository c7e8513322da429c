"""Pictures, animations and web pages of PLRs, errors, workspaces, problems and paths.

Every ``plot_`` function draws on the given axes, or on a new figure, and returns the axes; :func:`save` writes the
figure to a file. :func:`slices` draws functions of three or more dimensions. :func:`animate` shows robots that move
along a path. :func:`page` makes an interactive web page. Figures are made without pyplot, so no global state changes.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
