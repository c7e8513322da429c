"""Points at which proofs are put to the test: uniform ones, and ones beside walls, corners and borders of cells."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, Int

from plr_jax import PLR, Workspace

_NEAREST, _FARTHEST = -12.0, -2.0  # offsets as powers of ten, of the domain's width

Points = Float[np.ndarray, "n 2"]


def mixed_points(workspace: Workspace, plrs: Sequence[PLR], count: int, rng: np.random.Generator) -> Points:
    """Free points, so many: half uniform, a sixth each beside walls, corners and borders of cells.

    Offsets are log-uniform from 1e-12 to 1e-2 of the domain's width: across walls and borders to either side, from
    corners anywhere. One in ten is none at all.
    """
    uniform = workspace.sample_free(count // 2, int(rng.integers(2**31)))
    beside = (
        lambda: _beside_walls(workspace, count // 6, rng),
        lambda: _beside_corners(workspace, count // 6, rng),
        lambda: _beside_cells(workspace, plrs, count // 6, rng),
    )
    return np.concatenate([uniform, *(_free(draw, count // 6, workspace) for draw in beside)])


def _free(draw: Callable[[], Points], count: int, workspace: Workspace) -> Points:
    """The first free ones of many points that are drawn again and again."""
    found = np.empty((0, 2))
    while len(found) < count:
        points = draw()
        found = np.concatenate([found, points[workspace.is_free(points)]])
    return found[:count]


def _offsets(workspace: Workspace, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 1"]:
    size = 10.0 ** rng.uniform(_NEAREST, _FARTHEST, (count, 1)) * workspace.bounds.width.max()
    return size * rng.choice([-1.0, 1.0], (count, 1)) * (rng.random((count, 1)) >= 0.1)


def _beside_walls(workspace: Workspace, count: int, rng: np.random.Generator) -> Points:
    edge = rng.integers(len(workspace.boundary.segments), size=count)
    start, end = workspace.boundary.segments[edge].transpose(1, 0, 2)
    along = start + rng.random((count, 1)) * (end - start)
    return along + _offsets(workspace, count, rng) * workspace.boundary.normal[edge]


def _beside_corners(workspace: Workspace, count: int, rng: np.random.Generator) -> Points:
    vertex = rng.integers(len(workspace.boundary.vertices), size=count)
    angle = rng.uniform(0, 2 * np.pi, count)
    toward = np.column_stack([np.cos(angle), np.sin(angle)])
    return workspace.boundary.vertices[vertex] + _offsets(workspace, count, rng) * toward


def _beside_cells(workspace: Workspace, plrs: Sequence[PLR], count: int, rng: np.random.Generator) -> Points:
    boxes = [np.concatenate(plr.leaf_boxes, axis=1) for plr in plrs]
    boxes = np.concatenate(boxes)[_evenly([len(each) for each in boxes], count, rng)]
    place = rng.random((count, 2))
    at_border = rng.integers(3, size=count)  # across x, across y, at a corner
    for axis in range(2):
        on = at_border != axis
        place[on, axis] = rng.integers(2, size=on.sum())
    points = boxes[:, :2] + place * (boxes[:, 2:] - boxes[:, :2])
    return points + _offsets(workspace, count, rng) * rng.choice([-1.0, 0.0, 1.0], (count, 2))


def _evenly(sizes: list[int], count: int, rng: np.random.Generator) -> Int[np.ndarray, "count"]:
    """Random indices into lists one after the other, of each list equally many."""
    which = rng.integers(len(sizes), size=count)
    return np.cumsum([0, *sizes])[which] + (rng.random(count) * np.array(sizes)[which]).astype(int)
