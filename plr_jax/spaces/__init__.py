"""Configuration spaces: which configurations and boxes of configurations are free, and what a motion costs.

- Spaces: `PlaneSpace`, `RigidBodySpace`, `PlanarArm`, `VoxelSpace`, `ClearanceSpace`.
- Interfaces for spaces of your own: `FreeTest` suffices for estimates. `ConfigurationSpace`, with `CellState` and
  `MotionCost`, allows proofs; `SeesBoxes` tightens them.
- Costs: `RasterCost`, `LipschitzCost`, and the interfaces `CostMap` and `DirectionalCost`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
