import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import UNIT, cone, leaf_by_search, walled

from plr_jax.geometry.box import Box
from plr_jax.plr import construct
from plr_jax.plr.leaves.continuous.codec import numbers_of_polynomials
from plr_jax.plr.leaves.continuous.space import numbers_of_leaves
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.faces import face_points

STEP = 2.0**-22  # moves a 32-bit point of the unit square off a face


@pytest.fixture(scope="module", params=["continuous", "smooth"])
def leaf(request):
    return request.param


@pytest.fixture(scope="module")
def plr(leaf):
    return construct(walled, UNIT, leaf=leaf, max_leaves=100, num_samples=48)


def both_sides_of_faces(plr, distance_fn, seed=0):
    """Random points on faces, moved a step to either side, where both sides can be reached."""
    faces, rng = plr.stored.partition.faces, np.random.default_rng(seed)
    w = rng.random((20, plr.dim))
    on_face = plr.domain.lo + plr.domain.width * face_points(plr.cells, faces, w)
    across = STEP * plr.domain.width * np.eye(plr.dim)[faces.axis][:, None]
    below, above = ((on_face + sign * across).reshape(-1, plr.dim) for sign in (-1, 1))
    free = np.isfinite(distance_fn(below)) & np.isfinite(distance_fn(above))
    assert free.sum() > 500
    return below[free].astype(np.float32), above[free].astype(np.float32)


def test_no_jump_across_free_faces(plr):
    below, above = both_sides_of_faces(plr, walled)
    largest = walled(below).max()
    assert np.abs(np.asarray(plr(below)) - np.asarray(plr(above))).max() <= 1e-5 * largest
    # The points do tell the leaves apart: planes jump there.
    planes = construct(walled, UNIT, max_leaves=150)
    below, above = both_sides_of_planes(planes)
    assert np.abs(np.asarray(planes(below)) - np.asarray(planes(above))).max() > 1e-4


def both_sides_of_planes(planes):
    lo, hi = planes.leaf_boxes
    middle = (lo + hi)[lo[:, 0] > 0] / 2
    edge = np.stack([lo[lo[:, 0] > 0, 0], middle[:, 1]], axis=1)
    free = np.isfinite(walled(edge))
    return tuple((edge[free] + [sign * STEP, 0]).astype(np.float32) for sign in (-1, 1))


def test_gradients_of_order_one_do_not_jump_and_those_of_order_zero_do(plr, leaf):
    below, above = both_sides_of_faces(plr, walled)
    gradient = jax.vmap(jax.grad(plr))
    jump = np.abs(np.asarray(gradient(jnp.asarray(below))) - np.asarray(gradient(jnp.asarray(above)))).max()
    assert jump < 1e-3 if leaf == "smooth" else jump > 0.1


def test_nothing_blends_across_a_wall(plr):
    y = np.linspace(0.05, 0.6, 50)
    left, right = (np.stack([np.full(50, at), y], axis=1) for at in (0.4 - 1e-4, 0.5 + 1e-4))
    assert (walled(right) - walled(left)).min() > 0.2
    for side in (left, right):
        np.testing.assert_allclose(plr(side), walled(side), atol=0.03)


@pytest.mark.parametrize("dim", [1, 3])
def test_no_jump_in_other_dimensions(dim):
    def walled_anywhere(x):
        blocked = (np.abs(x[:, 0] - 0.45) < 0.05) & np.all(x[:, 1:] < 0.7, axis=1) if dim > 1 else False
        return np.where(blocked, np.inf, cone(x) ** 2)  # on a line, the cone itself needs one leaf

    plr = construct(walled_anywhere, (np.zeros(dim), np.ones(dim)), leaf="continuous", max_leaves=80, num_samples=48)
    below, above = both_sides_of_faces(plr, walled_anywhere)
    assert np.abs(np.asarray(plr(below)) - np.asarray(plr(above))).max() <= 1e-5
    assert np.isfinite(plr(below)).all()


def test_a_query_is_the_interpolation_of_nodal_values(x):
    plr = construct(walled, UNIT, leaf="continuous", max_leaves=60)
    stored = plr.stored
    node = (numbers_of_leaves(0, stored.partition.space) @ stored.decode()).reshape(-1, 2, 2)
    leaf = leaf_by_search(plr, x)
    lo, hi = plr.leaf_boxes
    expected = []
    for point, number in zip(x.astype(float), leaf, strict=True):
        s, t = (point - lo[number]) / (hi[number] - lo[number])
        (a, b), (c, d) = node[number]
        expected.append((1 - s) * ((1 - t) * a + t * b) + s * ((1 - t) * c + t * d))
    reachable = ~stored.partition.unreachable[leaf]
    np.testing.assert_allclose(np.asarray(plr(x))[reachable], np.array(expected)[reachable], atol=1e-5)


def test_points_within_rounding_of_a_border_are_answered_as_the_border_is(leaf):
    """The lookup rounds a place to 23 bits: a point next to a border may be found in the leaf behind it."""
    # Widths that are no powers of two, for which not even the lookup rounds the same way in all compiled code.
    domain = Box([0.0, -1.0], [24.0, 14.0])
    plr = construct(lambda x: np.hypot(x[:, 0] - 3, x[:, 1] - 7), domain, leaf=leaf, max_leaves=80, num_samples=32)
    rng = np.random.default_rng(0)
    for axis, corners in enumerate(plr.leaf_boxes[0].T):
        borders = np.unique(corners)[1:].repeat(50)
        x = (domain.lo + domain.width * rng.random((len(borders), 2))).astype(np.float32)
        x[:, axis] = borders
        at_border = plr(x)
        for _ in range(8):
            x[:, axis] = np.nextafter(x[:, axis], np.float32(-2))
            np.testing.assert_allclose(plr(x), at_border, atol=1e-4)


def test_numbers_are_the_cell_and_powers_of_the_place_in_it():
    """On the upper half along x, with 1, 2, 4, 8 at the corners (lower x first): 1 + t + 3 s + 3 s t."""
    cells = Cells.root(2).split(np.array([0]))
    found = numbers_of_polynomials(0, cells, np.array([[np.inf, 0, 0, 0], [1, 2, 4, 8]]))
    np.testing.assert_array_equal(found, [[2, 1, np.inf, 0, 0, 0], [3, 1, 1, 1, 3, 3]])
