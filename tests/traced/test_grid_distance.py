"""The public function for traced grids: edge cases of all kinds of paths, transformations of JAX, and errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from traced_helpers import CENTER, LEVELS, NOT_NUMBERS, NOWHERE, ROOM, SOMEWHERE, answers

from plr_jax import grid_distance

GOAL = np.array(CENTER, np.float32)
MOVES = ["any-angle", 8]


@pytest.mark.parametrize("moves", ["any-angle", 8, pytest.param(4, marks=pytest.mark.full)])
def test_points_and_goals_outside_or_blocked_are_inf_and_nan_stays(moves):
    cells, distances, gradients = (jax.tree.map(lambda each: each[LEVELS + 2 :], a) for a in answers(moves)[1:])
    points = NOWHERE + SOMEWHERE + NOT_NUMBERS
    is_somewhere = np.array([point in SOMEWHERE for point in points])
    is_nan = np.array([point in NOT_NUMBERS for point in points])
    to_center, *to_bad_goals, to_nan = np.asarray(distances)[:, :, : len(points)]
    assert np.isinf(to_center[:, ~(is_somewhere | is_nan)]).all() and np.isfinite(to_center[:, is_somewhere]).all()
    assert np.isnan(to_center[:, is_nan]).all() and (to_center[:, points.index(CENTER)] == 0).all()
    for found, of_cells in zip(to_bad_goals, cells[1:], strict=False):
        assert np.isinf(found[:, ~is_nan]).all() and np.isinf(of_cells).all()
    assert np.isnan(to_nan).all() and np.isnan(cells[-1]).all()
    of_x, of_goal = map(np.asarray, gradients)
    moves_away = is_somewhere & [point != CENTER for point in points]
    assert not of_x[0, : len(points)][~moves_away].any() and not of_x[1:].any() and not of_goal[1:].any()
    assert np.isfinite(of_goal[0]).all() and (moves == "any-angle") == of_x.any() == of_goal.any()


def test_a_field_out_of_a_compiled_batch_answers_as_one_map():
    fields, cells, *_ = answers(8)
    np.testing.assert_allclose(jax.tree.map(lambda each: each[0], fields).cells, cells[0])


@pytest.mark.parametrize("moves", MOVES)
def test_tracing_promotes_no_ranks_and_types_and_keeps_64_bits(moves):
    def answers(free, goal, x):
        field, pairs = grid_distance(free, goal, moves=moves), grid_distance(free, None, moves=moves)
        return field.cells, field(x), pairs(x, jnp.broadcast_to(goal, x.shape))

    for dtype in (np.float32, np.float64):
        strict = jax.numpy_dtype_promotion("strict")
        with jax.enable_x64(dtype == np.float64), jax.numpy_rank_promotion("raise"), strict:
            cells, *distances = jax.eval_shape(answers, ROOM, GOAL.astype(dtype), np.ones((2, 2), dtype))
        assert cells.shape == ROOM.shape and [each.shape for each in distances] == [(2,), (2,)]
        assert moves != "any-angle" or {each.dtype for each in (cells, *distances)} == {np.dtype(dtype)}


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"free": ROOM[0]}, r"free must be booleans of shape \(h, w\).*got bool of shape \(9,\)"),
        ({"free": np.stack([ROOM, ROOM])}, r"got bool of shape \(2, 4, 9\).*one map at a time"),
        ({"free": ROOM.astype(float)}, r"got float32 of shape \(4, 9\): is it `grid == 0`"),
        ({"free": np.zeros((0, 3), bool)}, "at least one cell"),
        ({"free": "maze"}, "free must be an array of booleans"),
        ({"goal": [1, 2, 3]}, r"goal must be real numbers of shape .*, rows \(x, y\), got int32 of shape \(3,\)"),
        ({"goal": [[1, 2], [3, 4]]}, r"goal must be one point of shape \(2,\), got shape \(2, 2\): use jax.vmap"),
        ({"goal": [True, False]}, "goal must be real numbers"),
        ({"goal": "there"}, "goal must be points"),
        ({"moves": 6}, "moves must be 'any-angle', 4 or 8, got 6"),
        ({"moves": None}, "moves must be 'any-angle', 4 or 8, got None"),
        ({"max_corners": 0}, "max_corners must be an integer >= 1, got 0"),
        ({"moves": 4, "max_corners": 9}, "max_corners requires any-angle paths, got 9 with moves=4: leave it out"),
        ({"free": np.ones((128, 128), bool)}, "at most 4,096 corners, got 8,065 on 128 x 128 cells"),
        ({"free": np.ones((500, 500), bool), "moves": 8}, "at most 159,640 cells for moves=8, got 500 x 500"),
    ],
)
def test_wrong_arguments_raise_also_while_traced(arguments, message, unchecked_types):
    arguments = {"free": ROOM, "goal": GOAL, **arguments}
    with pytest.raises(ValueError, match=message):
        grid_distance(**arguments)
    if isinstance(free := arguments.pop("free"), np.ndarray):
        with pytest.raises(ValueError, match=message):
            jax.eval_shape(lambda free: grid_distance(free, **arguments), free)


def traced_call(call):
    """Trace a call of a field and of pairs, which compiles nothing."""
    jax.eval_shape(lambda: [call(*(grid_distance(ROOM, goal, moves=4) for goal in (GOAL, None)))])


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda field, _: field([1.0, 2.0, 3.0]), r"x must be real numbers of shape .* got float32 of shape \(3,\)"),
        (lambda _, pairs: pairs(np.ones((3, 2)), np.ones((4, 2))), r"broadcast, got shapes \(3, 2\) and \(4, 2\)"),
    ],
)
def test_wrong_points_raise(call, message):
    with pytest.raises(ValueError, match=message):
        traced_call(call)


@pytest.mark.parametrize("x", [(3, 2), np.array([3, 2]), jnp.array([3, 2], jnp.int8)])
def test_integer_points_give_one_warning_for_a_call(x):
    of_fields = lambda *_: grid_distance(ROOM, x), lambda field, _: field(x), lambda field, _: jax.jit(field)(x)
    for call in (*of_fields, lambda _, pairs: pairs(x, x)):
        with pytest.warns(UserWarning, match="corners of cells.*add 0.5 to .column, row.") as warned:
            traced_call(call)
        assert len(warned) == 1


@pytest.mark.parametrize("moves", MOVES)
@pytest.mark.parametrize("number", [1, 9])  # 9 is the width of the map
def test_a_batch_of_fields_must_be_called_under_vmap(moves, number, unchecked_types):
    def batch(goal):
        return jax.vmap(lambda free: grid_distance(free, goal, moves=moves))(jnp.stack([ROOM] * number))

    for goal, use, call in (
        (GOAL, lambda field: field(GOAL), "field, x: field(x))(fields, x)"),
        (GOAL, lambda field: field.cells, "field: field.cells)(fields)"),
        (None, lambda field: field(GOAL, GOAL), "field, x, y: field(x, y))(fields, x, y)"),
    ):
        with pytest.raises(ValueError) as raised:
            jax.eval_shape(lambda goal=goal, use=use: use(batch(goal)))
        expected = f"This field holds a batch of {number} maps (it was made under vmap): use it as jax.vmap(lambda "
        assert str(raised.value) == expected + call + "."
        assert len(jax.eval_shape(lambda goal=goal, use=use: jax.vmap(use)(batch(goal)))) == number
