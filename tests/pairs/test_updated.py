"""Pairs of a map that has changed: what they list, answer and hold is as good as of pairs that are constructed."""

import numpy as np
import pytest
import shapely
from pair_helpers import MAZE, check_exact_and_bounded, two_batches
from piece_helpers import TEN, box, random_obstacle

from plr_jax import VisibilityGraph, Workspace, construct_pairs, load, save
from plr_jax.pairs import updated
from plr_jax.pairs.pair_plr import pairs_from_bytes
from plr_jax.pairs.stored import Stored

EIGHT = ((0, 0), (8, 8))
FIELDS = ("corner", "edges", "leaf", "listed", "rounding", "points")
POST = shapely.box(0.4, 0.42, 0.43, 0.46)  # in the maze


def check_lists(pairs, workspace, seed):
    """Fails unless the leaf of each point lists the corner at which the shortest path to each goal turns first."""
    stored, tested = pairs.stored, 0
    lo, hi = stored.cells.boxes(stored.domain)
    first = np.searchsorted(stored.leaf, np.arange(len(stored.cells) + 1))
    for goal in workspace.sample_free(3, seed):
        oracle = VisibilityGraph(workspace, goal)
        x = workspace.sample_free(30, seed + 1)
        for start in x[np.isfinite(oracle(x))]:
            if len(path := oracle.shortest_path(start)) > 2:
                leaf = np.flatnonzero(((lo <= start) & (start <= hi)).all(axis=1))[0]
                listed = stored.points[stored.listed[first[leaf] : first[leaf + 1]]]
                assert (np.abs(listed - path[1]).max(axis=1, initial=0.0) <= 1e-5).any()
                tested += 1
    return tested


def check_read_as_written(pairs):
    """Fails unless what is known of pairs is what their file says."""
    read = Stored.from_bytes(pairs.to_bytes())
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(pairs.stored, name), getattr(read, name))
    np.testing.assert_array_equal(pairs.stored.cells.position, read.cells.position)


def listed_by_points(pairs):
    """How many corners a point's leaf lists on average."""
    stored = pairs.stored
    count = np.bincount(stored.leaf, minlength=len(stored.cells))
    return np.ldexp(1.0, -stored.cells.depth.sum(axis=1)) @ count


@pytest.mark.full
@pytest.mark.parametrize("seed", range(6))
def test_lists_hold_all_corners_that_paths_turn_at_first_after_changes(seed, monkeypatch):
    monkeypatch.setattr(updated, "_MOST_CHANGED", 1.0)  # however much has changed
    rng = np.random.default_rng(seed)
    kinds, max_bytes = ["grid"] if seed % 3 == 0 else ["grid", "thin", "polygon", "box"], (1200, 4000)[seed % 2]
    workspace = Workspace(EIGHT, [random_obstacle(rng, "box") for _ in range(2)], squeeze=bool(seed % 2))
    pairs, tested = construct_pairs(workspace, max_bytes=max_bytes), 0
    for step in range(6):
        present = [i for i, each in enumerate(workspace.obstacles) if not each.is_empty]
        remove = rng.choice(present, rng.integers(0, 2)).tolist() if present else []
        corner = rng.uniform(0, 8, 2)
        add = [random_obstacle(rng, rng.choice(kinds)) for _ in range(rng.integers(0, 2))]
        add.append(shapely.box(*corner, *(corner + rng.uniform(0.1, 0.4, 2))))
        try:
            new = workspace.with_obstacles(add, remove)
            after = pairs.updated(new)
        except ValueError:  # nothing is free, or walls are too thin: to a construction as well
            with pytest.raises(ValueError):
                construct_pairs(workspace.with_obstacles(add, remove), max_bytes=max_bytes)
            continue
        workspace, pairs = new, after
        assert pairs.num_bytes <= max_bytes
        check_read_as_written(pairs)
        tested += check_lists(pairs, workspace, seed + 10 * step)
    assert tested > 10


@pytest.mark.full
@pytest.mark.parametrize("max_bytes", [1024, 4096])
def test_points_look_at_as_few_corners_as_after_a_construction(max_bytes):
    workspace, pairs, rng = MAZE, construct_pairs(MAZE, max_bytes=max_bytes), np.random.default_rng(3)
    for step in range(10):
        center = workspace.sample_free(1, step)[0]
        remove = [int(rng.integers(len(MAZE.obstacles), len(workspace.obstacles)))] if step in (4, 8) else []
        new = workspace.with_obstacles([shapely.box(*(center - 0.01), *(center + 0.01))], remove)
        pairs, workspace = pairs.updated(new), new
    anew = construct_pairs(workspace, max_bytes=max_bytes)
    assert anew.num_corners == pairs.num_corners > 30
    assert pairs.num_bytes <= max_bytes
    assert listed_by_points(pairs) < 1.1 * listed_by_points(anew)


def test_distances_and_bounds_are_those_of_the_new_map(maze):
    """A post is set down in a passage, all passages are closed, and opened again, and another post is set down."""
    first = MAZE.with_obstacles([POST])
    second = first.with_obstacles([shapely.box(-1, 0.3, 2, 0.31)], [len(MAZE.obstacles)])
    third = second.with_obstacles([shapely.box(0.6, 0.6, 0.65, 0.62)], [len(second.obstacles) - 1])
    pairs = maze
    for workspace in (first, second, third):
        pairs = pairs.updated(workspace)
        if workspace is second:
            is_below = pairs.stored.points[:, 1] < 0.305
            start, end = is_below[pairs.stored.edges].T
            assert is_below.any() and not is_below.all() and (start == end).all()
    x, y = two_batches(third, 400)
    assert check_exact_and_bounded(pairs, third, x, y) > 0.9


def test_what_the_change_does_not_meet_is_not_looked_at(monkeypatch):
    """A wall parts two halves; of leaves of the other one no sight is asked for."""
    posts = [box(2, 2, 3, 3), box(7, 7, 8, 8), box(4.9, 0, 5.1, 10)]
    workspace, asked = Workspace(TEN, posts), []
    pairs, may_see = construct_pairs(workspace, max_bytes=2048), updated.may_see

    def noted(table, corner, hulls):
        asked.append(hulls)
        return may_see(table, corner, hulls)

    monkeypatch.setattr(updated, "may_see", noted)
    new = pairs.updated(workspace.with_obstacles([box(1, 6, 1.5, 6.5)]), workspace, max_bytes=2048)
    on_right = np.concatenate([hulls[:, :, 0].min(axis=1) for hulls in asked]) > 5.1
    assert on_right.sum() < 10 and len(on_right) > len(pairs.stored.cells) // 8
    assert new.num_corners == pairs.num_corners + 4


def test_loaded_pairs_are_updated_alike_and_keep_their_label(maze, tmp_path):
    save(maze, tmp_path / "maze.plr")
    loaded, new = load(tmp_path / "maze.plr"), MAZE.with_obstacles([POST])
    pairs = maze.updated(new)
    assert loaded.updated(new, MAZE, max_bytes=1024).to_bytes() == pairs.to_bytes()
    labeled = maze.with_label("the maze").updated(new)
    assert labeled.label == "the maze" and labeled.num_bytes <= 1024
    # Of the same map, made in another way, whose outline stands in another order.
    other = Workspace(MAZE.bounds, [shapely.box(2, 2, 3, 3), *MAZE.obstacles[::-1]])
    assert loaded.updated(other.with_obstacles([POST]), other).num_corners == pairs.num_corners


@pytest.mark.usefixtures("unchecked_types")
def test_what_is_refused(maze):
    data, new = maze.to_bytes(), MAZE.with_obstacles([POST])
    for arguments, message in (
        ((None, MAZE), "of a Workspace"),
        ((new, MAZE.bounds), "before must be"),
        ((new, new), "another outline"),
        ((Workspace(TEN), MAZE), "bounds"),
    ):
        with pytest.raises(ValueError, match=message):
            maze.updated(*arguments, max_bytes=1024)
    with pytest.raises(ValueError, match=r"not known.*pairs.updated\(workspace, before\)"):
        pairs_from_bytes(data).updated(new)
    with pytest.raises(ValueError, match=r"alone take .*max_bytes=100"):
        maze.updated(new, MAZE, max_bytes=100)
    assert maze.to_bytes() == data


def test_an_interrupt_changes_nothing(maze, monkeypatch):
    data, new = maze.to_bytes(), MAZE.with_obstacles([POST])
    expected = maze.updated(new, MAZE, max_bytes=1024).to_bytes()

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(updated, "_fitted", interrupted)
        with pytest.raises(KeyboardInterrupt):
            maze.updated(new, MAZE, max_bytes=1024)
    assert maze.to_bytes() == data
    assert maze.updated(new, MAZE, max_bytes=1024).to_bytes() == expected


def test_a_smaller_budget_gives_a_coarser_partition_that_queries_can_read(maze):
    fine = construct_pairs(MAZE)
    coarse = fine.updated(MAZE, MAZE, max_bytes=400)
    assert coarse.num_bytes <= 400 and listed_by_points(coarse) < 1.2 * listed_by_points(
        construct_pairs(MAZE, max_bytes=400)
    )
    assert coarse.tables.x.shape[0] >= coarse.num_leaves
    # Of the same map what there is to spare, no more.
    same = fine.updated(MAZE, MAZE)
    assert same.num_bytes < fine.num_bytes and listed_by_points(same) < 1.01 * listed_by_points(fine)


def test_maps_with_other_rules_and_empty_ones():
    empty = Workspace(EIGHT)
    pairs = construct_pairs(empty)
    with_box = empty.with_obstacles([shapely.box(2, 2, 3, 3)])
    some = pairs.updated(with_box)
    assert some.num_corners == 4 and check_lists(some, with_box, 0) > 3
    assert some.updated(empty).num_leaves == 1
    touching = [shapely.box(2, 2, 4, 4), shapely.box(4, 4, 6, 6)]
    before, after = (Workspace(EIGHT, touching, squeeze=squeeze) for squeeze in (False, True))
    new = construct_pairs(before, max_bytes=2048).updated(after)
    assert new.to_bytes() == construct_pairs(after, max_bytes=2048).to_bytes()
