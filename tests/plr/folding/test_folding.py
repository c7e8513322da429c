import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax import Box, Dubins, Euclidean, ReedsShepp
from plr_jax.plr.folding.choice import folding_of

WINDOW = Box((-3, -4, -np.pi), (5, 3, np.pi), periodic=(False, False, True))
FOLDED = [
    (ReedsShepp((0.5, 0.25, 0), 1), WINDOW),
    (ReedsShepp((0.5, 0.25, 0.7), 1), WINDOW),
    (ReedsShepp((0.5, 0.25, 0), 1), Box((-3, -4, 0), (5, 3, 1))),
    (Dubins((0.5, 0.25, 0.1), 1), WINDOW),
    (Euclidean((1, 2, 3)), Box((0, 0, 0), (4, 4, 4))),
]


@pytest.mark.parametrize(("oracle", "domain"), FOLDED)
@given(st.lists(st.floats(0, 1), min_size=3, max_size=3))
def test_points_fold_into_the_box_and_are_as_far_from_the_goal_as_what_unfolds_from_there(oracle, domain, share):
    folding = folding_of(oracle, domain)
    x = (domain.lo + domain.width * share)[None]
    z = folding(x)
    assert folding.box.contains(z).all()
    y = folding.unfolded(z)
    assert domain.contains(y).all()
    np.testing.assert_allclose(oracle(y), oracle(x), rtol=1e-9, atol=1e-6)
    assert any(np.abs(domain.difference(image, x)).max() < 1e-9 for image, _ in folding.images(z))


def test_pieces_of_the_domain_fill_it():
    folding = folding_of(Euclidean((1.0, 2.0)), Box((0, 0), (4, 4)))
    lo, hi, leaf = folding.boxes(folding.box.lo[None], folding.box.hi[None])
    boxes = sorted(zip(lo.tolist(), hi.tolist(), strict=True))
    assert leaf.tolist() == [0, 0, 0, 0]
    assert boxes == [([0, 0], [1, 2]), ([0, 2], [1, 4]), ([1, 0], [4, 2]), ([1, 2], [4, 4])]
    with pytest.raises(ValueError, match="along other axes"):
        folding_of(*FOLDED[1]).boxes(np.zeros((1, 3)), np.ones((1, 3)))
