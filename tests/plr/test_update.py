"""Updates of certified cones after changes of the map."""

import numpy as np
import pytest
import shapely

from plr_jax import VisibilityGraph, Workspace, certify, construct, from_bytes

BOUNDS, GOAL = ((0, 0), (8, 6)), (1.0, 1.0)
WALLS = [shapely.box(2.5, 0, 3, 4), shapely.box(5, 2, 5.5, 6), shapely.box(6, 1, 7, 1.5)]
BYTES = 600


@pytest.fixture(scope="module")
def oracle():
    return VisibilityGraph(Workspace(BOUNDS, WALLS), GOAL)


@pytest.fixture(scope="module")
def plr(oracle):
    return construct(oracle, BOUNDS, leaf="cone", max_bytes=BYTES, certified=True).with_label("hall")


def check(plr, workspace, around=()):
    """Check bounds at points of all free space and around changes; return the mean error over the mean distance."""
    truth, rng = VisibilityGraph(Workspace(BOUNDS, workspace.obstacles), GOAL), np.random.default_rng(0)
    x = rng.uniform(0, 1, (4_000, 2)) * (8, 6)
    for each in around:
        lo, hi = np.array(each.bounds).reshape(2, 2)
        x = np.append(x, np.clip(lo - 0.2 + rng.random((1_000, 2)) * (hi - lo + 0.4), 0, (8, 6)), axis=0)
    distance = truth(x)
    x, distance = x[np.isfinite(distance)], distance[np.isfinite(distance)]
    lower, upper = (np.asarray(bound, float) for bound in plr.bounds(x))
    assert (lower <= distance + 1e-5).all() and (distance <= upper + 1e-5).all()
    return np.abs(np.asarray(plr(x), float) - distance).mean() / distance.mean()


def changed(oracle, *obstacles, remove=()):
    return oracle.with_workspace(oracle.workspace.with_obstacles(obstacles, remove))


@pytest.mark.full
def test_bounds_hold_after_many_changes(oracle, plr):
    rng = np.random.default_rng(1)
    for _ in range(6):
        lo = rng.uniform((0, 2), (7, 5))
        box = shapely.box(*lo, *(lo + rng.uniform(0.1, 0.8, 2)))
        present = [i for i, each in enumerate(oracle.workspace.obstacles) if i >= len(WALLS) and not each.is_empty]
        remove = [int(rng.choice(present))] if len(present) > 2 else []
        gone = [oracle.workspace.obstacles[i] for i in remove]
        oracle = changed(oracle, box, remove=remove)
        plr = plr.updated(oracle)
        assert plr.num_bytes <= BYTES and plr.label == "hall" and plr.max_error < 8
        assert check(plr, oracle.workspace, [box, *gone]) < 2e-4


def test_leaves_far_from_a_change_stay(oracle, plr):
    after = changed(oracle, shapely.box(7.9, 5.8, 7.95, 5.9))
    new = plr.updated(after)
    assert check(new, after.workspace) < 2e-4
    x = np.random.default_rng(0).uniform((0, 0), (5, 6), (2_000, 2))
    assert np.mean(np.asarray(new(x)) == np.asarray(plr(x))) > 0.98  # the budget may join or split a few leaves


@pytest.mark.full
def test_files_are_updated_where_parts_are_closed_and_opened(oracle, plr):
    door = shapely.box(2.4, 3.9, 3.1, 6)
    closed = changed(oracle, door)
    behind = from_bytes(plr.to_bytes()).updated(closed, oracle, max_bytes=BYTES)
    assert check(behind, closed.workspace, [door]) < 1e-6 and behind.num_leaves == 1
    opened = changed(closed, remove=[len(WALLS)])
    again = behind.updated(opened, closed, max_bytes=BYTES)
    assert check(again, opened.workspace, [door]) < 1e-3


def test_domains_that_no_longer_reach_the_goal_raise(oracle):
    far = construct(oracle, ((6, 0), (8, 6)), leaf="cone", max_bytes=300, certified=True)
    with pytest.raises(ValueError, match="cannot be reached any more from anywhere in the domain"):
        far.updated(changed(oracle, shapely.box(5.1, 0, 5.4, 6)))


@pytest.mark.parametrize(
    ("update", "message"),
    [
        (lambda plr, oracle: construct(oracle, BOUNDS, max_leaves=8).updated(oracle), "Only a PLR of certified"),
        (lambda plr, oracle: plr.updated(oracle.with_goal((2, 2))), "must have one goal"),
        (lambda plr, oracle: plr.updated(oracle, oracle, max_bytes=0), "max_bytes must be"),
        (
            lambda plr, oracle: plr.updated(oracle, changed(oracle, remove=[0])),
            "must be the oracle that the PLR is of",
        ),
        (lambda plr, oracle: from_bytes(plr.to_bytes()).updated(oracle), "which a PLR from a file does not know"),
    ],
)
def test_impossible_updates_raise(oracle, plr, update, message):
    with pytest.raises(ValueError, match=message):
        update(plr, oracle)


def test_updates_without_changes_keep_the_error(oracle, plr):
    again = plr.updated(oracle)
    assert again.num_leaves <= plr.num_leaves
    assert check(again, oracle.workspace) <= 1.01 * check(plr, oracle.workspace)


@pytest.mark.full
def test_updates_of_an_empty_map_fill_the_budget():
    """One leaf does not show what a leaf is worth, so all leaves are rebuilt."""
    empty = VisibilityGraph(Workspace(BOUNDS, []), GOAL)
    plr = construct(empty, BOUNDS, leaf="cone", max_bytes=300, certified=True)
    after = changed(empty, shapely.box(2, 2, 3, 3))
    new, anew = plr.updated(after), construct(after, BOUNDS, leaf="cone", max_bytes=300, certified=True)
    assert plr.num_leaves == 1 and 250 < new.num_bytes <= 300
    assert check(new, after.workspace) < 1.1 * check(anew, after.workspace)


@pytest.mark.parametrize("limits", [{"tolerance": 0.1}, {"max_leaves": 20, "max_bytes": 500}])
def test_updates_keep_the_limits_of_the_construction(oracle, limits):
    plr = construct(oracle, BOUNDS, leaf="cone", certified=True, **limits)
    new = plr.updated(changed(oracle, shapely.box(3.5, 4.5, 4, 5)))
    assert new.num_leaves <= limits.get("max_leaves", 1_000)
    assert plr.max_error < new.max_error < 1.5 * plr.max_error or new.max_error <= plr.max_error


def test_updates_after_certify_and_too_small_budgets(oracle, plr):
    proven = certify(construct(oracle, BOUNDS, leaf="cone", max_bytes=BYTES), oracle)
    assert proven.updated(oracle).max_error == pytest.approx(proven.max_error, rel=0.3)
    with pytest.raises(ValueError, match=r"max_bytes=3\d\d is too small: one leaf takes"):
        proven.with_label("x" * 290).updated(oracle, max_bytes=310)
    with pytest.raises(ValueError, match="must exceed the label's"):
        proven.with_label("x" * 290).updated(oracle, max_bytes=10)
