from .grid_pairs import DistanceToCell as DistanceToCell
from .grid_pairs import GridPairs as GridPairs
from .grid_pairs import construct_grid_pairs as construct_grid_pairs
from .metric_pairs import MetricPairs as MetricPairs
from .metric_pairs import construct_metric_pairs as construct_metric_pairs
from .pair_plr import PairPLR as PairPLR
from .pair_plr import construct_pairs as construct_pairs
from .query import PreparedGoals as PreparedGoals
