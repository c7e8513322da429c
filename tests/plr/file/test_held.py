"""What holds a file tells its bytes, whatever it answers."""

import jax
import pytest

import plr_jax


@pytest.fixture(scope="module", params=["one goal", "pairs"])
def held(request):
    if request.param == "pairs":
        return plr_jax.construct_pairs(plr_jax.scenes.maze().workspace, max_bytes=512)
    return plr_jax.construct(plr_jax.Euclidean((0.0, 0.0)), ((0, 0), (1, 1)), max_leaves=8)


def test_bytes_are_those_of_the_file(held, tmp_path):
    plr_jax.save(held, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == held.to_bytes()
    assert len(held.to_bytes()) == held.num_bytes
    assert held.resident_bytes == sum(a.nbytes for a in jax.tree_util.tree_leaves(held.tables)) > 0
