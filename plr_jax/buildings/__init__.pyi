from .building import Building as Building
from .building import BuildingOracle as BuildingOracle
from .building_plr import BuildingPLR as BuildingPLR
from .floors import Link as Link
from .floors import Route as Route
from .numpy_building import NumpyBuildingPLR as NumpyBuildingPLR
from .numpy_building import load_numpy as load_numpy
