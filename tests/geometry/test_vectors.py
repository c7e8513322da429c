import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.geometry.vectors import orientation


@given(st.integers(0, 100_000))
def test_orientations_of_all_but_parallel_vectors_have_the_sign_of_integers(seed):
    rng = np.random.default_rng(seed)
    u = rng.integers(-(2**40), 2**40, (200, 2))
    v = np.rint(u * rng.choice([-1, 0.5, 1, 1.0 - 2.0**-30], (200, 1))).astype(np.int64) + rng.integers(
        -1, 2, (200, 2)
    )
    right = [a * d - b * c for (a, b), (c, d) in zip(u.tolist(), v.tolist(), strict=True)]
    unit = 2.0 ** rng.integers(-60, 60)
    found = orientation(*(unit * u.T), *(unit * v.T))
    np.testing.assert_array_equal(np.sign(found), np.sign(np.array(right, float)))
