"""Room 2, store: piecewise linear regressions over a binary space partition."""

from plr_jax.plr._assembly import from_bytes
from plr_jax.plr._certify import certify
from plr_jax.plr._construct import construct
from plr_jax.plr._construct_many import construct_many
from plr_jax.plr._io import load, load_pairs, save
from plr_jax.plr._plr import PLR
from plr_jax.plr._stack import PLRStack, evaluate, stack
from plr_jax.plr._trace import Traces, TraceStatus, trace
from plr_jax.plr.grid_pairs.model import GridDistance, GridPairs, construct_grid_pairs
from plr_jax.plr.growth.limits import ConstructionInterrupted
from plr_jax.plr.growth.rules import best_axis, center_error, cyclic_axis, largest_error, maximum_depth
from plr_jax.plr.layers.coarsen import coarsen
from plr_jax.plr.layers.progressive import progressive
from plr_jax.plr.leaves.continuous.model import Continuous
from plr_jax.plr.leaves.plane.model import Plane
from plr_jax.plr.metric_pairs.model import MetricPairs, construct_metric_pairs
from plr_jax.plr.pairs.pair_plr import PairPLR
from plr_jax.plr.refinement.driver import RefinementInterrupted, refine
from plr_jax.plr.refinement.face_samples import Faces, sample_faces
from plr_jax.plr.refinement.losses import Planes, eikonal, jumps, quantile, squared
from plr_jax.plr.refinement.report import Refinement
from plr_jax.plr.sampling.cell_fit import CellFit
from plr_jax.plr.sampling.plane_fits import least_squares, midrange

__all__ = [
    "PLR",
    "CellFit",
    "ConstructionInterrupted",
    "Continuous",
    "Faces",
    "GridDistance",
    "GridPairs",
    "MetricPairs",
    "PLRStack",
    "PairPLR",
    "Plane",
    "Planes",
    "Refinement",
    "RefinementInterrupted",
    "TraceStatus",
    "Traces",
    "best_axis",
    "center_error",
    "certify",
    "coarsen",
    "construct",
    "construct_grid_pairs",
    "construct_many",
    "construct_metric_pairs",
    "cyclic_axis",
    "eikonal",
    "evaluate",
    "from_bytes",
    "jumps",
    "largest_error",
    "least_squares",
    "load",
    "load_pairs",
    "maximum_depth",
    "midrange",
    "progressive",
    "quantile",
    "refine",
    "sample_faces",
    "save",
    "squared",
    "stack",
    "trace",
]
