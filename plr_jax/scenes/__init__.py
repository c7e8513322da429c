"""Scenes of our experiments, the scene file format, and readers of maps, which may raise ``OSError``."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
