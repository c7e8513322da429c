"""Build, store and evaluate piecewise linear regressions (PLRs) of distance functions, and prove error bounds."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
