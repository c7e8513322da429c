import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import cone, leaf_by_search, walled

from plr_jax.geometry.box import Box
from plr_jax.plr import PLR, construct, evaluate
from plr_jax.plr.leaves.continuous.basis import numbers_of_leaves
from plr_jax.plr.leaves.continuous.codec import decode
from plr_jax.plr.leaves.continuous.evaluation import _evaluate, continuous_from_bytes
from plr_jax.plr.leaves.continuous.growth import construct_continuous
from plr_jax.plr.partition.faces import face_points

SQUARE = Box((0, 0), (1, 1))
STEP = 2.0**-22  # moves a 32-bit point of the unit square off a face


@pytest.fixture(scope="module", params=[0, 1])
def plr(request):
    return construct_continuous(walled, SQUARE, max_leaves=150, order=request.param)


@pytest.fixture(scope="module")
def x():
    return np.random.default_rng(0).random((1000, 2)).astype(np.float32)


def both_sides_of_faces(plr, distance_fn, seed=0):
    """Random points on faces, moved a step to either side, where both sides can be reached."""
    faces, rng = plr.partition.faces, np.random.default_rng(seed)
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
    planes = construct(walled, SQUARE, max_leaves=150)
    below, above = both_sides_of_planes(planes)
    assert np.abs(np.asarray(planes(below)) - np.asarray(planes(above))).max() > 1e-4


def both_sides_of_planes(planes):
    lo, hi = planes.leaf_boxes
    middle = (lo + hi)[lo[:, 0] > 0] / 2
    edge = np.stack([lo[lo[:, 0] > 0, 0], middle[:, 1]], axis=1)
    free = np.isfinite(walled(edge))
    return tuple((edge[free] + [sign * STEP, 0]).astype(np.float32) for sign in (-1, 1))


def test_gradients_of_order_one_do_not_jump_and_those_of_order_zero_do(plr):
    below, above = both_sides_of_faces(plr, walled)
    gradient = jax.vmap(jax.grad(plr))
    jump = np.abs(np.asarray(gradient(jnp.asarray(below))) - np.asarray(gradient(jnp.asarray(above)))).max()
    assert jump < 1e-3 if plr.order == 1 else jump > 0.1


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

    plr = construct_continuous(walled_anywhere, (np.zeros(dim), np.ones(dim)), max_leaves=120)
    below, above = both_sides_of_faces(plr, walled_anywhere)
    assert np.abs(np.asarray(plr(below)) - np.asarray(plr(above))).max() <= 1e-5
    assert np.isfinite(plr(below)).all()


def test_a_query_is_the_interpolation_of_nodal_values(x):
    plr = construct_continuous(walled, SQUARE, max_leaves=150)
    _, order, partition, space, values = decode(plr.to_bytes())
    assert order == 0
    node = (numbers_of_leaves(0, space) @ values.decode()).reshape(-1, 2, 2)
    leaf = leaf_by_search(plr, x)
    lo, hi = plr.leaf_boxes
    expected = []
    for point, number in zip(x.astype(float), leaf, strict=True):
        s, t = (point - lo[number]) / (hi[number] - lo[number])
        (a, b), (c, d) = node[number]
        expected.append((1 - s) * ((1 - t) * a + t * b) + s * ((1 - t) * c + t * d))
    reachable = ~partition.unreachable[leaf]
    np.testing.assert_allclose(np.asarray(plr(x))[reachable], np.array(expected)[reachable], atol=1e-5)


def test_every_free_point_is_answered(plr):
    x = np.random.default_rng(1).random((50_000, 2))
    free = np.isfinite(walled(x))
    assert np.isfinite(np.asarray(plr(x))[free]).all()
    edge = np.linspace(0, 1, 3000)
    for at in (0.0, 1.0):
        assert np.isfinite(plr(np.stack([edge, np.full(3000, at)], axis=1))[(edge < 0.4) | (edge > 0.5)]).all()
    beside = np.stack([np.full(500, 0.4 + 1e-6), np.linspace(0, 0.7, 500)], axis=1)  # a little way into the wall
    assert np.isfinite(plr(beside)).all()


def test_gradients_are_finite_differences_inside_cells(plr):
    with jax.enable_x64(True):
        x = np.random.default_rng(2).random((2000, 2))
        lo, hi = (corner[leaf_by_search(plr, x)] for corner in plr.leaf_boxes)
        inside = np.all((x > lo + 0.01 * (hi - lo)) & (x < hi - 0.01 * (hi - lo)), axis=1)
        inside &= np.isfinite(plr(x))
        x = x[inside]
        gradient = np.asarray(jax.vmap(jax.grad(plr))(jnp.asarray(x)))
        for axis in range(2):
            h = 1e-5 * np.eye(2)[axis]
            slope = (np.asarray(plr(x + h)) - np.asarray(plr(x - h))) / 2e-5
            scale = np.linalg.norm(gradient, axis=1)
            assert np.max(np.abs(slope - gradient[:, axis]) / np.maximum(scale, 0.1)) < 1e-4


def test_gradient_is_finite_everywhere():
    plr = construct_continuous(lambda x: np.where(x[:, 0] < 0.1, cone(x), np.inf), SQUARE, max_leaves=200, order=1)
    points = jnp.array([[0.05, 0.5], [0.1, 0.5], [0.9, 0.5], [-0.5, 0.5], [1e30, 0.5], [jnp.inf, 0.5]])
    gradient = np.asarray(jax.vmap(jax.grad(plr))(points))
    assert np.isfinite(gradient).all() and (gradient[2:] == 0).all() and (gradient[0] != 0).any()


def test_outside_nan_and_edges(plr):
    answers = plr(np.array([[1.0, 1.0], [0.0, 0.0], [1.0, 0.0], [1.0001, 0.5], [0.5, -0.0001], [np.inf, 0.5]]))
    np.testing.assert_array_equal(np.isfinite(answers), [True, True, True, False, False, False])
    assert np.isposinf(answers[3:]).all()
    assert np.isnan(plr(np.array([[np.nan, 0.5], [0.5, np.nan], [np.nan, 7.0], [np.inf, np.nan]]))).all()


def test_leaves_far_inside_an_obstacle_are_infinite():
    plr = construct_continuous(lambda x: np.where(x[:, 0] < 0.1, cone(x), np.inf), SQUARE, max_leaves=300)
    assert np.isfinite(plr(np.array([[0.1 + 1e-6, 0.5]]))).all()
    assert np.isposinf(plr(np.array([[0.9, 0.5]]))).all()


def test_jit_vmap_and_a_loop_agree(plr, x):
    plain = np.asarray(plr(x))
    np.testing.assert_allclose(jax.jit(plr)(x), plain, rtol=1e-6)
    np.testing.assert_allclose(jax.jit(lambda plr, x: plr(x))(plr, x), plain, rtol=1e-6)
    np.testing.assert_allclose(jax.vmap(plr)(jnp.asarray(x)), plain, rtol=1e-6)
    np.testing.assert_allclose([plr(point) for point in x[:20]], plain[:20], rtol=1e-6)
    assert plr(x.reshape(10, 100, 2)).shape == (10, 100)


def test_evaluate_is_calling(plr, x):
    np.testing.assert_array_equal(evaluate(plr, x), plr(x))


def test_it_is_not_stacked_as_if_it_had_planes(plr):
    with pytest.raises(ValueError, match="Only plain PLRs can be stacked, that of robot 1 is ContinuousPLR"):
        PLR.stack([construct(walled, SQUARE, max_leaves=4), plr])


def test_a_second_one_of_its_size_class_compiles_nothing(x):
    first = construct_continuous(walled, SQUARE, max_leaves=60)
    second = construct_continuous(lambda x: walled(x) + 1, SQUARE, max_leaves=60)
    first(x)
    compiled = _evaluate._cache_size()
    second(x)
    assert _evaluate._cache_size() == compiled


def test_what_is_loaded_is_what_was_saved(plr, x):
    again = continuous_from_bytes(plr.to_bytes())
    np.testing.assert_array_equal(again(x), plr(x))
    assert again.to_bytes() == plr.to_bytes() and len(plr.to_bytes()) == plr.num_bytes
    for first, second in zip(*(jax.tree_util.tree_leaves(one.tables) for one in (again, plr)), strict=True):
        np.testing.assert_array_equal(first, second)


def test_attributes(plr):
    lo, hi = plr.leaf_boxes
    assert plr.num_leaves == len(lo) == 150 and plr.dim == 2 and plr.domain == SQUARE
    assert np.prod(hi - lo, axis=1).sum() == pytest.approx(1.0)
    assert plr.resident_bytes >= 4 * 150 * (6, 18)[plr.order]
    assert f"order={plr.order}" in repr(plr)


def test_far_from_the_origin_the_precision_stays():
    origin = np.array([5e5, 2e6])
    here = construct_continuous(cone, Box((0, 0), (8, 8)), max_leaves=50)
    there = construct_continuous(lambda x: cone(x - origin), Box(origin, origin + 8), max_leaves=50)
    x = np.random.default_rng(0).integers(0, 8, size=(50, 2)).astype(np.float32)
    np.testing.assert_allclose(there(x + origin.astype(np.float32)), here(x), atol=1e-4)


@pytest.mark.parametrize(
    ("points", "message"), [(np.zeros((3, 3)), "got"), (1.0, "got"), (["a", "b"], "real numbers")]
)
def test_bad_points_are_refused(plr, points, message):
    with pytest.raises(ValueError, match=message):
        plr(points)


def test_strict_promotion(plr, x):
    with jax.numpy_dtype_promotion("strict"):
        plr(x)
        jax.vmap(jax.value_and_grad(plr))(jnp.asarray(x))


@pytest.mark.parametrize("order", [0, 1])
def test_points_within_rounding_of_a_border_are_answered_as_the_border_is(order):
    """The lookup rounds a place to 23 bits: a point next to a border may be found in the leaf behind it."""
    # Widths that are no powers of two, for which not even the lookup rounds the same way in all compiled code.
    domain = Box([0.0, -1.0], [24.0, 14.0])
    plr = construct_continuous(lambda x: np.hypot(x[:, 0] - 3, x[:, 1] - 7), domain, max_leaves=300, order=order)
    rng = np.random.default_rng(0)
    for axis, corners in enumerate(plr.leaf_boxes[0].T):
        borders = np.unique(corners)[1:].repeat(50)
        x = (domain.lo + domain.width * rng.random((len(borders), 2))).astype(np.float32)
        x[:, axis] = borders
        at_border = plr(x)
        for _ in range(8):
            x[:, axis] = np.nextafter(x[:, axis], np.float32(-2))
            np.testing.assert_allclose(plr(x), at_border, atol=1e-4)
