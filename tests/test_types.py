import os

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from plr_jax import Euclidean, construct
from plr_jax._arrays import padded
from plr_jax._types import DimensionedFn, PiecewiseFunction


@pytest.mark.skipif(os.environ.get("PLR_JAX_CHECK_SHAPES") != "1", reason="PLR_JAX_CHECK_SHAPES=1 checks shapes")
def test_wrong_shape_inside_package_raises():
    padded(np.zeros((2, 3)), 4)
    with pytest.raises(TypeCheckError):
        padded([0.0, 1.0], 4)


def test_plr_is_piecewise_function_filling_its_domain():
    oracle = Euclidean((0.5, 0.5))
    plr = construct(oracle, ((0, 0), (1, 1)), max_leaves=4)
    assert isinstance(plr, PiecewiseFunction) and not isinstance(oracle, PiecewiseFunction)
    assert isinstance(plr, DimensionedFn) and isinstance(oracle, DimensionedFn) and not isinstance(len, DimensionedFn)
    lo, hi = map(np.asarray, plr.leaf_boxes)
    assert np.prod(hi - lo, axis=1).sum() == pytest.approx(np.prod(plr.domain.width))
