import os

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from plr_jax import Euclidean, Roadmap, VisibilityGraph, Workspace, construct
from plr_jax._arrays import padded
from plr_jax._types import DimensionedFn, PiecewiseFunction

ROOM = Workspace(((0, 0), (1, 1)))
GOAL = (0.5, 0.5)
ORACLES = [Euclidean(GOAL), VisibilityGraph(ROOM, GOAL), Roadmap.from_workspace(ROOM, GOAL, 5)]
PLRS = [construct(ORACLES[0], ROOM.bounds, leaf=leaf, max_leaves=4) for leaf in ("plane", "continuous")]


@pytest.mark.parametrize("fn", [*ORACLES, *PLRS], ids=lambda fn: type(fn).__name__)
def test_oracles_and_plrs_say_how_many_coordinates_they_take(fn):
    assert isinstance(fn, DimensionedFn) and fn.dim == 2


@pytest.mark.parametrize("plr", PLRS, ids=lambda plr: type(plr).__name__)
def test_plrs_are_piecewise_functions_that_fill_their_domain(plr):
    assert isinstance(plr, PiecewiseFunction)
    lo, hi = map(np.asarray, plr.leaf_boxes)
    assert np.prod(hi - lo, axis=1).sum() == pytest.approx(np.prod(plr.domain.width))


def test_what_promises_nothing():
    for fn in (len, *ORACLES):
        assert not isinstance(fn, PiecewiseFunction)
    assert not isinstance(len, DimensionedFn) and not isinstance(ROOM.bounds, DimensionedFn)


@pytest.mark.skipif(os.environ.get("PLR_JAX_CHECK_SHAPES") != "1", reason="PLR_JAX_CHECK_SHAPES=1 checks shapes")
def test_a_wrong_shape_within_the_package_is_caught():
    padded(np.zeros((2, 3)), 4)
    with pytest.raises(TypeCheckError):
        padded([0.0, 1.0], 4)
