"""Small batches outside of jit are answered by NumPy, all others by compiled code."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from plr_helpers import UNIT
from portable_helpers import case, full, hard_points, same_bits

from plr_jax import PLR, VisibilityGraph, Workspace, construct, from_bytes, stack
from plr_jax.plr import _stack, query, small_batches, team
from plr_jax.plr._plr import LowerBound, leaf_of

PROGRAMS = (
    query.evaluate_points,
    query.evaluate_points_anywhere,
    query.bound_points,
    query.waypoints_of_points,
    query.find_leaves,
    team._evaluate,
    _stack._evaluate,
)


def num_compiled():
    return sum(program._cache_size() for program in PROGRAMS)


def eager_answers(plr, x):
    """Yield distances, waypoints, leaves and bounds, of one PLR, a stack and a team, in 32 and 64 bits."""
    wide, index = x.astype(np.float64) * (1 + 1e-12), np.arange(len(x)) % 4 - 1
    stacked, of_team = stack([plr, plr]), PLR.stack([plr, plr])
    yield from (plr(wide), plr(wide, outside="clamp"), leaf_of(plr, wide).astype(float))
    yield stacked(index, wide, outside="nan")
    yield of_team(np.stack([wide, wide[::-1]], axis=1))
    if not plr.tables.unresolved:
        yield from (plr(jnp.asarray(x)), plr(x, outside="nan"))
        with jax.enable_x64(True):
            yield plr(wide)
    if plr.max_error is not None:
        yield from (*plr.bounds(wide), LowerBound.stack([plr.lower])(wide[:, None]))
    if plr.leaf.name == "cone":
        yield plr.waypoint(wide)


@pytest.mark.parametrize(
    "name", ["maze of cones", *full("straight lines", "random planes on a line", "far folded car")]
)
def test_numpy_answers_of_small_batches_equal_compiled_ones(name, monkeypatch):
    plr = from_bytes(case(name).to_bytes())  # has not been called yet
    x = hard_points(plr, 100, seed=3).astype(np.float32)
    x[np.abs(x) < 1e-11] = 0  # smaller numbers are left to compiled code
    before = num_compiled()
    small = [np.asarray(answer) for answer in eager_answers(plr, x)]
    assert num_compiled() == before
    monkeypatch.setattr(small_batches, "_MOST_WORK", -1)
    monkeypatch.delattr(small_batches.SmallBatches, "_by_numpy")
    for mine, theirs in zip(small, eager_answers(plr, x), strict=True):
        assert same_bits(mine, np.asarray(theirs))


AT_CORNER = construct(VisibilityGraph(Workspace(UNIT), (0, 0)), UNIT, leaf="cone")
NUMBERS = st.floats(width=32) | st.sampled_from([1e-20, -1e-20, 1e-40, -1e-40, 2.0**-63, 2.0**-126, -0.0, 1.0])


@given(x=arrays(np.float32, (4, 2), elements=NUMBERS))
def test_tiny_and_huge_coordinates_get_equal_answers(x):
    """XLA takes squares below the smallest 32-bit float for 0."""
    AT_CORNER._answer.work.clear()
    assert same_bits(AT_CORNER(x), query.evaluate_points(AT_CORNER.tables, x))


def test_program_is_compiled_after_much_work_of_numpy(monkeypatch):
    """Compiled code always answers committed points, and keeps the answers on their device."""
    plr, x, num_programs = from_bytes(AT_CORNER.to_bytes()), np.random.default_rng(0).random((37, 2)), []
    monkeypatch.setattr(small_batches, "_MOST_WORK", 3 * (small_batches._WORK_OF_CALL + x.size))
    for points in 5 * [x] + [x[:36], jax.device_put(x[:35], jax.devices()[0])]:
        answer = plr(points)
        num_programs.append(query.evaluate_points._cache_size())
    assert answer.committed and np.diff(num_programs).tolist() == [0, 0, 1, 0, 0, 1]
    with jax.transfer_guard("disallow"):
        assert not plr(jax.device_put(x[:34])).committed
