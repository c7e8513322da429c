"""The team planner, its heuristics, and replanning while the goals or the map change.

`bl_plan` and `replan` return a `Solution` with a `Status` and `Stats`; `lifelong` returns a `LifelongRun`. Heuristics
are `straight_line`, `sum_of_distances` and `zero`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
