"""Room 2, store: piecewise linear regressions over a binary space partition."""

from plr_jax.plr._construct import ConstructionInterrupted as ConstructionInterrupted
from plr_jax.plr._construct import construct as construct
from plr_jax.plr._continuous import ContinuousPLR as ContinuousPLR
from plr_jax.plr._continuous_construct import construct_continuous as construct_continuous
from plr_jax.plr._faces import Faces as Faces
from plr_jax.plr._faces import sample_faces as sample_faces
from plr_jax.plr._fit import CellFit as CellFit
from plr_jax.plr._fit import least_squares as least_squares
from plr_jax.plr._fit import midrange as midrange
from plr_jax.plr._losses import eikonal as eikonal
from plr_jax.plr._losses import jumps as jumps
from plr_jax.plr._losses import quantile as quantile
from plr_jax.plr._losses import squared as squared
from plr_jax.plr._plr import PLR as PLR
from plr_jax.plr._plr import evaluate as evaluate
from plr_jax.plr._refine import RefinementInterrupted as RefinementInterrupted
from plr_jax.plr._refine import refine as refine
from plr_jax.plr._refinement import Refinement as Refinement
from plr_jax.plr._saved import from_bytes as from_bytes
from plr_jax.plr._saved import load as load
from plr_jax.plr._saved import save as save
from plr_jax.plr._split import best_axis as best_axis
from plr_jax.plr._split import center_error as center_error
from plr_jax.plr._split import cyclic_axis as cyclic_axis
from plr_jax.plr._split import largest_error as largest_error
from plr_jax.plr._split import maximum_depth as maximum_depth
