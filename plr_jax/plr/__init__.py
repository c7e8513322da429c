"""Build, store and evaluate piecewise linear regressions (PLRs) of distance functions, and prove error bounds.

- Classes of PLRs: `PLR`, in NumPy `NumpyPLR`, with trainable values `TunablePLR`, many in one function `PLRStack`.
- Leaf models with parameters: `Plane`, `Continuous`.
- Rules for `BuildOptions`, functions of a `CellFit`: `least_squares` fits, `largest_error`, `center_error` and
  `maximum_depth` choose cells to split, `best_axis` and `cyclic_axis` choose the axis.
- Paths that `trace` reads from a PLR: `Traces`, `TraceStatus`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
