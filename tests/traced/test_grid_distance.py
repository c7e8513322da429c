import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grid_helpers import drawn

from plr_jax import grid_distance

FREE = drawn("....#.", ".##.#.", ".#..##", "...#..")  # right of the middle nothing leads to the goal
GOAL = np.array([2.5, 2.5], np.float32)
MOVES = ["any-angle", 4, 8]


@pytest.mark.parametrize("moves", MOVES)
class TestOfEveryKind:
    def test_it_is_a_pytree_that_leaves_jit_and_is_mapped_over_maps_and_goals(self, moves):
        maps = np.stack([FREE, FREE[:, ::-1]])
        goals = np.stack([GOAL, GOAL + 2, GOAL + 0.25])
        make = jax.jit(jax.vmap(jax.vmap(lambda f, g: grid_distance(f, g, moves=moves), (None, 0)), (0, None)))
        fields = make(maps, goals)
        each = jax.tree.map(lambda leaf: leaf[1, 2], fields)
        np.testing.assert_allclose(each.cells, grid_distance(maps[1], goals[2], moves=moves).cells, rtol=1e-6)

    @pytest.mark.full
    def test_a_scan_carries_it_and_a_checkpoint_recomputes_it(self, moves):
        @jax.jit
        @jax.checkpoint
        def total(path, field):
            def step(field, x):
                return grid_distance(FREE, x, moves=moves), field(x)

            return jax.lax.scan(step, field, path)[1].sum()

        path = jnp.array([[0.5, 0.5], [0.5, 3.5]])
        value, gradient = jax.value_and_grad(total)(path, grid_distance(FREE, GOAL, moves=moves))
        pairs = grid_distance(FREE, None, moves=moves)
        assert value == pytest.approx(float(pairs(GOAL, path[0]) + pairs(path[0], path[1])), rel=1e-6)
        assert jnp.isfinite(gradient).all()

    def test_edges(self, moves):
        field, pairs = grid_distance(FREE, GOAL, moves=moves), grid_distance(FREE, None, moves=moves)
        nowhere = [[-0.1, 3], [3, 4.01], [1.5, 1.5], [5.5, 0.5], [np.inf, 1], [1, -np.inf], [1e30, 1]]
        assert (np.asarray(field(nowhere)) == np.inf).all() and (np.asarray(pairs(nowhere, GOAL)) == np.inf).all()
        assert np.isnan(field([[np.nan, 1], [1, np.nan]])).all() and np.isnan(pairs(GOAL, [1, np.nan]))
        assert np.isfinite(field([[0, 0], [0, 4], [1, 2.5]])).all() and field(GOAL) == 0 == pairs(GOAL, GOAL)
        for goal in ([1.5, 1.5], [9.0, 9.0], [np.inf, 0]):
            assert (np.asarray(grid_distance(FREE, goal, moves=moves).cells) == np.inf).all()
        unknown = grid_distance(FREE, [np.nan, 1], moves=moves)
        assert np.isnan(unknown.cells).all() and np.isnan(unknown([0.5, 0.5]))

    def test_gradients_are_0_where_there_is_no_path_and_never_nan(self, moves):
        def slope(x, goal):
            return jnp.stack(jax.grad(lambda x, g: grid_distance(FREE, g, moves=moves)(x), argnums=(0, 1))(x, goal))

        def of_pairs(x, goal):
            return jnp.stack(jax.grad(grid_distance(FREE, None, moves=moves), argnums=(0, 1))(x, goal))

        there = np.array([[-1, 3], [1.5, 1.5], [5.5, 0.5], [np.inf, 1], [1e30, 1], GOAL], np.float32)
        goals = np.array([GOAL, [1.5, 1.5], [np.inf, 1], [-1e30, 1]], np.float32)
        nan = np.array([np.nan, 1], np.float32)
        for of in (slope, of_pairs):
            of = jax.jit(jax.vmap(of))
            with jax.debug_nans(True):
                assert not np.any(of(np.repeat(there, len(goals), 0), np.tile(goals, (len(there), 1))))
            assert not np.any(of(np.stack([nan, GOAL] * 12), np.stack([GOAL, nan] * 12)))

    def test_under_the_strictest_rules_of_jax(self, moves):
        x = np.array([[0.5, 0.5], [0.5, 3.5]], np.float32)
        with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
            field, pairs = grid_distance(FREE, GOAL, moves=moves), grid_distance(FREE, None, moves=moves)
            np.testing.assert_allclose(field(x), pairs(x, x[:1] * 0 + GOAL[None]), rtol=1e-6)
            assert field.cells.shape == FREE.shape


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"free": FREE[0]}, r"free must be booleans of shape \(h, w\).*got bool of shape \(6,\)"),
        ({"free": np.stack([FREE, FREE])}, r"got bool of shape \(2, 4, 6\).*one map at a time"),
        ({"free": FREE.astype(float)}, r"got float32 of shape \(4, 6\): is it `grid == 0`"),
        ({"free": np.zeros((0, 3), bool)}, "at least one cell"),
        ({"free": "maze"}, "free must be an array of booleans"),
        (
            {"goal": [1, 2, 3]},
            r"goal must be real numbers of shape \(..., 2\), rows \(x, y\), got int32 of shape \(3,\)",
        ),
        ({"goal": [[1, 2], [3, 4]]}, r"goal must be one point of shape \(2,\), got shape \(2, 2\): use jax.vmap"),
        ({"goal": [True, False]}, "goal must be real numbers"),
        ({"goal": "there"}, "goal must be points"),
        ({"moves": 6}, 'moves must be "any-angle", 4 or 8, got 6'),
        ({"moves": None}, 'moves must be "any-angle", 4 or 8, got None'),
        ({"max_corners": 0}, "max_corners must be an integer >= 1, got 0"),
        ({"moves": 4, "max_corners": 9}, "max_corners requires any-angle paths, got 9 with moves=4: leave it out"),
        (
            {"free": np.ones((128, 128), bool)},
            "at most 4,096 corners, got 8,065 on 128 x 128 cells: pass max_corners, or use moves=8",
        ),
        ({"free": np.ones((500, 500), bool), "moves": 8}, "at most 159,640 cells for moves=8, got 500 x 500"),
    ],
)
def test_wrong_arguments_are_told_while_traced(arguments, message, unchecked_types):
    with pytest.raises(ValueError, match=message):
        grid_distance(**{"free": FREE, "goal": GOAL, **arguments})
    if isinstance(arguments.get("free"), np.ndarray):
        others = {"goal": GOAL, **arguments}
        with pytest.raises(ValueError, match=message):
            jax.eval_shape(lambda free: grid_distance(**{**others, "free": free}), others["free"])


def test_wrong_points_are_told(unchecked_types):
    field, pairs = grid_distance(FREE, GOAL, moves=4), grid_distance(FREE, None, moves=4)
    with pytest.raises(
        ValueError, match=r"x must be real numbers of shape \(..., 2\), rows \(x, y\), got float32 of shape \(3,\)"
    ):
        field([1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match=r"x and y must broadcast, got shapes \(3, 2\) and \(4, 2\)"):
        pairs(np.ones((3, 2)), np.ones((4, 2)))


def test_integer_points_give_one_warning_for_a_call():
    field, pairs = grid_distance(FREE, GOAL), grid_distance(FREE, None)
    integers = (3, 2), np.array([3, 2]), jnp.array([3, 2], jnp.int8)
    for call in (lambda x: grid_distance(FREE, x), field, jax.jit(field), lambda x: pairs(x, x)):
        for x in integers:
            with pytest.warns(UserWarning, match="corners of cells.*add 0.5 to .column, row.") as warned:
                call(x)
            assert len(warned) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert field((3.0, 2)) == pairs(GOAL, [3, 2.0])


@pytest.mark.parametrize("moves", MOVES)
@pytest.mark.parametrize("number", [1, 3, 6])  # 6 is the width of the maps
def test_a_batch_of_fields_must_be_called_under_vmap(moves, number, unchecked_types):
    maps = np.stack([FREE] * number)
    fields = jax.vmap(lambda free: grid_distance(free, GOAL, moves=moves))(maps)
    message = f"holds a batch of {number} maps .it was made under vmap.: use it as "
    for use, call in (
        (lambda fields: fields(GOAL), r"jax.vmap\(lambda field, x: field\(x\)\)\(fields, x\)"),
        (lambda fields: fields.cells, r"jax.vmap\(lambda field: field.cells\)\(fields\)"),
    ):
        for each in (use, jax.jit(use)):
            with pytest.raises(ValueError, match=message + call):
                each(fields)
        assert len(jax.jit(jax.vmap(use))(fields)) == number
    pairs = jax.vmap(lambda free: grid_distance(free, None, moves=moves))(maps)
    with pytest.raises(ValueError, match=message + r"jax.vmap\(lambda field, x, y: field\(x, y\)\)"):
        pairs(GOAL, GOAL)
