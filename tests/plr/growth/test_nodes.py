import numpy as np
import pytest
from plr_helpers import UNIT, cone

from plr_jax.plr import construct
from plr_jax.plr.certificate.certificate import Proof
from plr_jax.plr.growth.limits import NEVER, Nodes, check_limits, nodes_of_fit, split_order
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import Sampler, sample_pattern


def nodes(priority, bound, axis=0, **limits):
    """The two halves of the square along x, which a plane fits badly, as nodes."""
    fit = Sampler(cone, UNIT, None, *2 * [sample_pattern(2, 32, 0.0, 0)], 14)(Cells.root(2).split(np.array([0])))
    given = (limits.get(name) for name in ("max_depth", "max_leaves", "max_bytes", "tolerance"))
    found = check_limits(2, 2, False, lambda dim, num_leaves: 4 * num_leaves, *given, Proof.NONE, 13)
    coefficients = np.column_stack([fit.center, fit.half])
    return nodes_of_fit(fit, coefficients, np.array(bound), np.array(priority), np.full(2, axis), found), fit


def test_a_key_is_the_priority_but_never_above_the_parents():
    found, _ = nodes([0.3, 0.7], [0.5, 0.5])
    assert found.key.tolist() == [0.3, 0.5]


def test_what_the_limits_close_is_never_split():
    assert nodes([0.3, 0.7], [1.0, 1.0], tolerance=0.3)[0].key.tolist() == [NEVER, 0.7]
    assert nodes([0.3, 0.7], [1.0, 1.0], max_depth=1)[0].key.tolist() == [NEVER, NEVER]
    assert nodes([0.0, 1e-9], [1.0, 1.0])[0].key.tolist() == [NEVER, NEVER]


def test_errors_are_means_and_shares_are_volumes():
    found, fit = nodes([0.3, 0.7], [1.0, 1.0])
    np.testing.assert_allclose(found.share, [0.5, 0.5])
    np.testing.assert_allclose(found.error, np.average(np.abs(fit.residual), axis=1, weights=fit.pattern.weight))


def test_every_prefix_of_the_order_of_splits_is_a_tree():
    """Node 2's key is its parent's; of equal keys the earlier node, the parent, comes first."""
    key = np.array([0.9, 0.2, 0.9, NEVER, 0.1])
    child = np.array([1, -1, 3, -1, -1])
    cells = Cells.root(2)[np.zeros(5, int)]
    tree = Nodes(cells, np.zeros((5, 3)), np.zeros(5), np.zeros(5), np.zeros(5, int), key, child)
    order = split_order(tree)
    assert order.tolist() == [0, 2, 1, 4] and len(tree) == 3
    assert tree.leaves_after(order[:0]).tolist() == [0]
    assert tree.leaves_after(order[:1]).tolist() == [1, 2]
    assert tree.leaves_after(order[:2]).tolist() == [1, 3, 4]


@pytest.mark.parametrize("leaf", ["plane", "continuous"])
@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"split": lambda fit: np.full(len(fit.cells), 5)}, "split must return one axis from 0 to 1 a cell"),
        ({"split": lambda fit: np.zeros(0, int)}, "split must return one axis"),
        ({"should_split": lambda fit: np.ones(len(fit.cells) + 1)}, "should_split must return one priority a cell"),
        ({"should_split": lambda fit: np.full(len(fit.cells), np.nan)}, "should_split must return one priority"),
    ],
)
def test_bad_rules_are_refused(leaf, rules, message):
    with pytest.raises(ValueError, match=message):
        construct(cone, UNIT, leaf=leaf, max_leaves=10, **rules)
