"""Batches that are split into parts, one part per core at a time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax._compiled import answered_in_parts, is_on_one_host, num_cores


def sums(x, y):
    return (np.asarray(x).sum(axis=1) - np.asarray(y)[:, 0],)


@pytest.mark.parametrize("shape", [(0,), (1,), (7,), (9,), (1000,), (30, 1)])
def test_rows_keep_their_place_and_batches_broadcast(shape):
    rng = np.random.default_rng(0)
    x, y = (rng.uniform(size=size).astype(np.float32) for size in ((*shape, 3), (*shape[:-1], shape[-1], 1)))
    y = y[:, 0] if len(shape) == 2 else y
    (answer,) = answered_in_parts(sums, (8, 64), x, y)
    np.testing.assert_allclose(answer, x.sum(axis=-1) - y[..., 0], rtol=1e-6, atol=1e-6)


def test_parts_share_one_size_and_errors_are_raised():
    sizes = set()

    def refuses(x):
        sizes.add(len(x))
        if (x == 999).any():
            raise ValueError("no")
        return (x[:, 0],)

    rows = np.arange(1000, dtype=np.float32)[:, None]
    with pytest.raises(ValueError, match="no"):
        answered_in_parts(refuses, (8, 64), rows)
    assert sizes == {64}


def test_traced_arrays_are_on_no_host():
    assert is_on_one_host(np.zeros(3), jnp.zeros(3))
    jax.jit(lambda x: pytest.fail("traced") if is_on_one_host(x) else x)(jnp.zeros(3))
    assert num_cores() >= 1
