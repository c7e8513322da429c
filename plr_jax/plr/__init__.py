"""Piecewise linear regressions over a binary space partition (public names: ``__init__.pyi``)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
