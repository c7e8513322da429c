from .building import Building as Building
from .building import BuildingOracle as BuildingOracle
from .building_plr import BuildingPLR as BuildingPLR
from .floors import Floors as Floors
from .floors import Link as Link
from .floors import Route as Route
