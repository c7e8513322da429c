"""Oracles: distances to a goal, computed on the host from a map, a roadmap, a grid, or in closed form."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
