"""PLRs (piecewise linear regressions): build, prove, store and evaluate them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
