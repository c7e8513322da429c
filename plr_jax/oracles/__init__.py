"""Oracles: functions that compute distances to a goal on the CPU, from a map, a roadmap, a grid or a formula."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
