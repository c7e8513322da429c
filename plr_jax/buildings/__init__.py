"""Buildings: several floors joined by links such as stairs, lifts, and doors that open one way.

A `Building` has floors and `Link`s. Its `BuildingOracle` computes exact distances and a `Route` from each point, and
constructs a `BuildingPLR`. `load_numpy` reads the file of a `BuildingPLR` as a `NumpyBuildingPLR`.

All floors lie side by side in one *plane* (``floors.py``), where links are arcs of the visibility graph. So the
code for the plane also serves buildings: exact distances (``building.py``) and PLRs (``building_plr.py``).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
