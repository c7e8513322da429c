"""Room 2, store: piecewise linear regressions over a binary space partition.

The public names are listed in ``__init__.pyi`` and loaded when they are first used: what reads a PLR without JAX does
not import it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
