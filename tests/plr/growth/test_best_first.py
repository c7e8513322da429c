import heapq

import pytest
from plr_helpers import UNIT, cone, walled

from plr_jax.plr import best_axis, construct, largest_error
from plr_jax.plr.leaves.plane import model
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import Sampler
from plr_jax.plr.sampling.pattern import sample_pattern

AXIS_DEPTH = 7  # in the plane, for files of up to 2,048 bytes


def best_first_twin(distance_fn, max_leaves):
    """Best-first construction with a priority queue, one leaf at a time: the leaves."""
    patterns = [sample_pattern(2, num_samples, 0.0, 0) for num_samples in (192, 8 * 192)]
    sampler = Sampler(distance_fn, UNIT, None, *patterns, AXIS_DEPTH)

    def push(queue, cells):
        for cell in range(len(cells)):
            fit = sampler(cells[[cell]])
            fit = sampler.densely(cells[[cell]]) if fit.is_hardly_seen[0] else fit
            heapq.heappush(queue, (-largest_error(fit)[0], len(queue), best_axis(fit), cells[[cell]]))

    queue, done = [], []
    push(queue, Cells.root(2))
    while queue and len(queue) + len(done) < max_leaves:
        priority, _, axis, cells = heapq.heappop(queue)
        if priority < -1e-6 and cells.depth[0, axis[0]] < AXIS_DEPTH:
            push(queue, cells.split(axis))
        else:
            done.append(cells)
    leaves = [entry[3] for entry in queue] + done
    return {(*leaf.depth[0], *leaf.position[0]) for leaf in leaves}


@pytest.mark.parametrize("distance_fn", [walled, cone])
@pytest.mark.parametrize("max_leaves", [1, 2, 17, 60])
def test_rounds_build_the_tree_of_a_priority_queue(distance_fn, max_leaves):
    cells = construct(distance_fn, UNIT, max_leaves=max_leaves).cells
    found = {(*depth, *position) for depth, position in zip(cells.depth, cells.position, strict=True)}
    assert found == best_first_twin(distance_fn, max_leaves)


def test_chunks_of_samples_change_nothing(monkeypatch):
    whole = construct(walled, UNIT, max_leaves=80)
    monkeypatch.setattr(model, "_SAMPLES_AT_ONCE", 300)
    assert construct(walled, UNIT, max_leaves=80).to_bytes() == whole.to_bytes()
