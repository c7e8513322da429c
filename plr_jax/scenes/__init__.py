"""Scenes of our experiments, the scene file format, readers of public map formats, and random variants.

All readers raise ``OSError`` if a file cannot be read.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
