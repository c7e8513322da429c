"""Distance functions over configuration spaces, compressed into kilobytes of planes.

Discover distance (``VisibilityGraph``, ``Roadmap``, ``ReedsShepp`` or any function of a batch of points), store it
(``construct``, ``save``, ``load``), use it (``plr(x)`` under ``jax.jit``, ``jax.vmap`` and ``jax.grad``; or as the
heuristic of ``bl_plan``, which plans for several robots at once). ``descend`` follows a distance function to its
goal, and ``optimize_paths`` shortens paths.

A ``DistanceFn`` is any function of points ``(n, dim)`` that answers distances ``(n,)``, ``inf`` where the goal cannot
be reached; a ``HeuristicFn`` one of joint configurations ``(n, robots, dof)`` that answers costs-to-go ``(n,)``.

The public names are listed in ``__init__.pyi`` and loaded when they are first used: a program that only loads and
queries a PLR imports neither Shapely nor NetworkX nor Matplotlib, nor the slow parts of SciPy.
"""

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
