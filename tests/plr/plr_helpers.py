"""Helpers for tests of PLRs: distance functions, partitions, files, and slow versions of functions."""

import struct
import tracemalloc
import zlib
from dataclasses import replace

import numpy as np
import pytest

from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.plr._file import DecodedFile
from plr_jax.plr.leaf_faces import shared_faces
from plr_jax.plr.leaves import leaf_model, leaf_names
from plr_jax.plr.leaves.base import LinearLeafModel
from plr_jax.plr.leaves.cone.codec import ConeFiles
from plr_jax.plr.leaves.continuous import StoredValues, TiedPartition
from plr_jax.plr.leaves.plane import IndependentLeafModel, quantize
from plr_jax.plr.sampling import Sampler, sample_pattern
from plr_jax.plr.tables import build_tables
from plr_jax.plr.tree import Cells, tree_of, tree_of_axes

UNIT = Box([0, 0], [1, 1])
LINEAR = [name for name in leaf_names() if isinstance(leaf_model(name), LinearLeafModel)]  # all but cones
INDEPENDENT = [name for name in LINEAR if isinstance(leaf_model(name), IndependentLeafModel)]  # may jump anywhere
PROVEN = [name for name in leaf_names() if leaf_model(name).splits_by_proven_error]


def points(n, seed, dim=2):
    """Return random points of the unit box."""
    return np.random.default_rng(seed).random((n, dim))


def cone(x):
    return np.sqrt(np.sum(x * x, axis=1))


def walled(x):
    """Return distances to (0.1, 0.1) in the unit square, around a wall with x in [0.4, 0.5] and y <= 0.7."""
    goal, left, right = np.array([0.1, 0.1]), np.array([0.4, 0.7]), np.array([0.5, 0.7])
    from_left = np.linalg.norm(left - goal)
    sees_goal = (x[:, 0] <= 0.4) | (x[:, 1] - 0.1 >= 2 * (x[:, 0] - 0.1))
    over, behind = np.linalg.norm(x - left, axis=1), np.linalg.norm(x - right, axis=1) + 0.1
    value = np.where(x[:, 1] >= 0.7, over, behind) + from_left
    value = np.where(sees_goal, np.linalg.norm(x - goal, axis=1), value)
    in_wall = (x[:, 0] > 0.4) & (x[:, 0] < 0.5) & (x[:, 1] < 0.7)
    return np.where(in_wall, np.inf, value)


def three_leaves():
    """Return three cells of a square: the lower half along x, and the two quarters above it."""
    halves = Cells.root(2).split(np.array([0]))
    return halves[[0]].append(halves[[1]].split(np.array([1])))


def leaf_by_search(plr, x):
    """Return the index of the leaf that contains each point, by comparison with the boxes of all leaves."""
    lo, hi = plr.leaf_boxes
    last = hi >= plr.domain.hi  # the upper edge of the domain belongs to the last cell
    inside = (x[:, None] >= lo) & ((x[:, None] < hi) | (last & (x[:, None] <= hi)))
    found = inside.all(axis=2)
    assert (found.sum(axis=1) == 1).all(), "the leaves do not tile the domain"
    return found.argmax(axis=1)


def evaluate_by_search(plr, x):
    leaf = leaf_by_search(plr, x)
    return plr.intercept[leaf] + np.sum(plr.slope[leaf] * x, axis=1)


def random_partition(seed, dim, num_splits):
    """Return the leaves of a tree that grew by splits of random leaves along random axes, in traversal order."""
    rng = np.random.default_rng(seed)
    leaves = [(np.zeros(dim, int), np.zeros(dim, int))]
    for _ in range(num_splits):
        chosen, axis = rng.integers(len(leaves)), np.eye(dim, dtype=int)[rng.integers(dim)]
        depth, position = leaves[chosen]
        leaves[chosen : chosen + 1] = [(depth + axis, (position << axis) + half * axis) for half in range(2)]
    return Cells(*map(np.array, zip(*leaves, strict=True)))


def lstsq_plane(u, value, weight):
    """Fit one cell's plane by ``np.linalg.lstsq``; return the center value and the half-differences."""
    root = np.sqrt(weight)
    design = np.concatenate([np.ones((len(u), 1)), u], axis=1) * root[:, None]
    return np.linalg.lstsq(design, value * root, rcond=None)[0]


def sampler_of(distance_fn, domain, weight_fn=None, num_samples=64, max_axis_depth=14):
    """Return a sampler that samples all cells equally densely."""
    patterns = 2 * [sample_pattern(domain.dim, num_samples, 0.0, 0)]
    return Sampler(distance_fn, domain, weight_fn, *patterns, max_axis_depth)


def chain(axes):
    """Return the leaves of a tree that splits its lowest cell along each of the given axes, one after another."""
    leaves = Cells.root(int(max(axes)) + 1)
    for axis in axes:
        leaves = leaves[[0]].split(np.array([axis])).append(leaves[1:])
    return leaves


def random_contents(seed, dim, leaf, cells=None, periodic=()):
    """Return file contents with random values in the leaves of a random partition, or in given cells."""
    rng = np.random.default_rng(seed)
    tree = tree_of(random_partition(seed, dim, 20) if cells is None else cells)
    cells, model = tree.leaves, leaf_model(leaf)
    unreachable = rng.random(len(cells)) < 0.2
    unreachable[0] = False
    if leaf in INDEPENDENT:
        center = np.where(unreachable, np.inf, rng.normal(size=len(cells)))
        others = rng.normal(size=(len(cells), model.min_samples(dim) - 1))
        stored = quantize(center, others, int(rng.choice([4, 11, 16, 20, 32])))
    elif leaf == "cone":
        goals = Sources(rng.normal(size=(5, dim)), np.zeros(5), np.arange(5))
        stored = ConeFiles(goals, Box([-5.0] * dim, [5.0] * dim)).stored(rng.integers(5, size=len(cells)))
        offset = np.float32(rng.random(len(stored.sources.code))).astype(float)
        stored = replace(stored, sources=replace(stored.sources, root_offset=offset))
    else:
        faces = shared_faces(tree, periodic)
        partition = TiedPartition(tree, unreachable, faces, rng.random(len(faces)) < 0.8)
        partition.tied[~partition.may_be_tied()] = False
        stored = StoredValues.quantize(partition, rng.normal(size=len(partition.space.free_dofs)), 0.01)
    domain = Box(rng.normal(size=dim) - 5, rng.normal(size=dim) + 5, periodic or None)
    return DecodedFile(domain, model, tree, stored)


def quarters_in_another_order():
    """Return file contents of the unit square's quarters, first split along axis 1: values 0, 1 below, 2, 3 above."""
    tree = tree_of_axes([np.array([1]), np.array([0, 0]), np.full(4, -1)], 2)
    planes = quantize(np.arange(4.0), np.zeros((4, 2)), 32)
    return DecodedFile(UNIT, leaf_model("plane"), tree, planes)


def sealed(content):
    """Return the bytes of a file of one layer, with the right checksum appended."""
    return content + struct.pack("<I", zlib.crc32(content))


def contents_of_planes(cells, planes, domain=UNIT):
    """Return the contents of a file of planes."""
    return DecodedFile(domain, leaf_model("plane"), tree_of(cells), planes)


def assert_refused_for_little(read, given, message, most):
    """Check that reading raises a ``ValueError`` with this message before it has allocated ``most`` bytes."""
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=message):
            read(given)
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def leaf_by_position(cells, x):
    """Return the leaf of points of the unit cube, from the integers of the cells."""
    slots = np.minimum(np.floor(x[:, None] * 2.0**cells.depth).astype(int), 2**cells.depth - 1)
    found = (slots == cells.position).all(axis=2)
    assert (found.sum(axis=1) == 1).all()
    return found.argmax(axis=1)


def tables_of_numbers(cells, num_bytes, leaf=None):
    """Return lookup tables of the unit cube whose leaf ``i`` has the constant value ``i``."""
    numbers = np.zeros((len(cells), 1 + cells.dim))
    numbers[:, 0] = np.arange(len(cells))
    domain = Box(np.zeros(cells.dim), np.ones(cells.dim))
    return build_tables(domain, cells, numbers, leaf or leaf_model("plane"), num_bytes)
