"""Batches in parts, on all cores: every row is answered once, in its place."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax._cores import answered_in_parts, is_on_one_host, num_cores


def sums(x, y):
    return (jnp.asarray(x).sum(axis=1) - jnp.asarray(y)[:, 0],)


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 250, 1000])
def test_every_row_is_answered_in_its_place(count):
    rng = np.random.default_rng(count)
    x, y = rng.uniform(size=(count, 3)).astype(np.float32), rng.uniform(size=(count, 1)).astype(np.float32)
    (answer,) = answered_in_parts(sums, (8, 64), x, y)
    np.testing.assert_allclose(answer, x.sum(axis=1) - y[:, 0], rtol=1e-6, atol=1e-6)


def test_batches_are_broadcast():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(size=(30, 1, 3)).astype(np.float32), rng.uniform(size=(20, 1)).astype(np.float32)
    (answer,) = answered_in_parts(sums, (8, 64), x, y)
    assert answer.shape == (30, 20)
    np.testing.assert_allclose(answer, x.sum(axis=2) - y[:, 0], rtol=1e-6, atol=1e-6)


def test_parts_are_of_one_size_a_power_of_two():
    sizes = set()

    def seen(x):
        sizes.add(len(x))
        return (x[:, 0],)

    answered_in_parts(seen, (8, 64), np.zeros((1000, 1), np.float32))
    assert sizes == {64}


def test_an_error_in_a_part_is_raised():
    def refuses(x):
        if x[0, 0] > 0:
            raise ValueError("no")
        return (x[:, 0],)

    rows = np.arange(1000, dtype=np.float32)[:, None]
    with pytest.raises(ValueError, match="no"):
        answered_in_parts(refuses, (8, 64), rows)


def test_what_is_traced_is_on_no_host():
    assert is_on_one_host(np.zeros(3), jnp.zeros(3))
    jax.jit(lambda x: pytest.fail("traced") if is_on_one_host(x) else x)(jnp.zeros(3))


def test_there_is_a_core():
    assert num_cores() >= 1
