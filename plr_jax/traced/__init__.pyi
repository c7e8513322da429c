from ._grid_distance import GridDistance as GridDistance
from ._grid_distance import GridDistances as GridDistances
from ._grid_distance import grid_distance as grid_distance
from ._polygon_distance import PolygonDistance as PolygonDistance
from ._polygon_distance import PolygonDistances as PolygonDistances
from ._polygon_distance import polygon_distance as polygon_distance
from ._polygon_distance import polygons_of_discs as polygons_of_discs
