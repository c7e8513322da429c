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
    """That bounds hold, at points of all free space and around what has changed; returns the share that is off."""
    truth, rng = VisibilityGraph(Workspace(BOUNDS, workspace.obstacles), GOAL), np.random.default_rng(0)
    x = [rng.uniform(0, 1, (4_000, 2)) * (8, 6)]
    for each in around:
        lo, hi = np.array(each.bounds).reshape(2, 2)
        x.append(np.clip(lo - 0.2 + rng.random((1_000, 2)) * (hi - lo + 0.4), 0, (8, 6)))
    x = np.concatenate(x)
    distance = truth(x)
    x, distance = x[np.isfinite(distance)], distance[np.isfinite(distance)]
    lower, upper = (np.asarray(bound, float) for bound in plr.bounds(x))
    assert (lower <= distance + 1e-5).all() and (distance <= upper + 1e-5).all()
    return np.abs(np.asarray(plr(x), float) - distance).mean() / distance.mean()


@pytest.mark.full
def test_bounds_hold_and_errors_stay_after_many_changes(oracle, plr):
    rng, workspace = np.random.default_rng(1), oracle.workspace
    for _ in range(12):
        lo = rng.uniform((0, 2), (7, 5))
        box = shapely.box(*lo, *(lo + rng.uniform(0.1, 0.8, 2)))
        present = [i for i, each in enumerate(workspace.obstacles) if i >= len(WALLS) and not each.is_empty]
        remove = [int(rng.choice(present))] if len(present) > 2 else []
        gone = [workspace.obstacles[i] for i in remove]
        workspace = workspace.with_obstacles([box], remove)
        oracle = oracle.with_workspace(workspace)
        plr = plr.updated(oracle)
        assert plr.num_bytes <= BYTES and plr.label == "hall" and plr.max_error < 8
        check(plr, workspace, [box, *gone])
    assert check(plr, workspace) < 2e-4


def test_leaves_that_hold_stay_as_they_are(oracle, plr):
    far = shapely.box(7.9, 5.8, 7.95, 5.9)
    after = oracle.with_workspace(oracle.workspace.with_obstacles([far]))
    new = plr.updated(after)
    x = np.random.default_rng(0).uniform((0, 0), (5, 6), (2_000, 2))
    assert np.mean(new(x) == plr(x)) > 0.98  # two leaves may be one now, and one two, as the budget asks for


@pytest.mark.full
def test_what_is_closed_off_and_opened_again_is_answered_again(oracle, plr):
    door = shapely.box(2.4, 3.9, 3.1, 6)
    closed = oracle.with_workspace(oracle.workspace.with_obstacles([door]))
    behind = plr.updated(closed, oracle, max_bytes=BYTES)
    assert check(behind, closed.workspace, [door]) < 1e-6 and behind.num_leaves == 1
    opened = closed.with_workspace(closed.workspace.with_obstacles(remove=[len(WALLS)]))
    again = behind.updated(opened, closed, max_bytes=BYTES)
    assert check(again, opened.workspace, [door]) < 1e-3


def test_a_domain_from_which_nothing_leads_to_the_goal_any_more_is_refused(oracle):
    far = construct(oracle, ((6, 0), (8, 6)), leaf="cone", max_bytes=300, certified=True)
    closed = oracle.with_workspace(oracle.workspace.with_obstacles([shapely.box(5.1, 0, 5.4, 6)]))
    with pytest.raises(ValueError, match="cannot be reached any more from anywhere in the domain"):
        far.updated(closed)


@pytest.mark.full
def test_where_another_way_is_taken_all_behind_moves_by_one_number():
    """Both ways around a wall end at one corner: beyond it, distances grow alike, and leaves stay."""
    walls = [shapely.box(2, 1, 6, 5), shapely.box(6.5, 0, 7, 3), shapely.box(6.5, 3.2, 7, 6)]
    before = VisibilityGraph(Workspace(BOUNDS, walls), (1.0, 2.9))
    after = before.with_workspace(before.workspace.with_obstacles([shapely.box(3, 0, 3.2, 1)]))
    plr = construct(before, BOUNDS, leaf="cone", max_bytes=BYTES, certified=True)
    new = plr.updated(after, before, max_bytes=BYTES)
    x = np.random.default_rng(0).uniform((7.05, 3.21), (8, 6), (500, 2))
    moved = after(x) - before(x)
    np.testing.assert_allclose(new(x) - plr(x), moved, atol=1e-3)
    lower, upper = new.bounds(x)
    assert (lower <= after(x) + 1e-5).all() and (upper >= after(x) - 1e-5).all()


def test_what_cannot_be_updated_is_refused(oracle, plr):
    planes = construct(oracle, BOUNDS, max_leaves=8)
    with pytest.raises(ValueError, match="Only a PLR of certified cones"):
        planes.updated(oracle, oracle)
    with pytest.raises(ValueError, match="must have one goal"):
        plr.updated(oracle.with_goal((2, 2)))
    with pytest.raises(ValueError, match="max_bytes must be"):
        plr.updated(oracle, oracle, max_bytes=0)
    other = oracle.with_workspace(oracle.workspace.with_obstacles(remove=[0]))
    with pytest.raises(ValueError, match="before must be the oracle that the PLR is of"):
        plr.updated(oracle, other)
    with pytest.raises(ValueError, match="which a PLR from a file does not know"):
        from_bytes(plr.to_bytes()).updated(oracle)


def test_nothing_changes_where_nothing_has(oracle, plr):
    again = plr.updated(oracle)
    assert again.num_leaves <= plr.num_leaves and check(again, oracle.workspace) <= 1.01 * check(
        plr, oracle.workspace
    )


@pytest.mark.full
def test_a_file_is_updated_as_what_it_was_written_of(oracle, plr):
    box = shapely.box(3.5, 4.5, 4, 5)
    after = oracle.with_workspace(oracle.workspace.with_obstacles([box]))
    read = from_bytes(plr.to_bytes()).updated(after, oracle, max_bytes=BYTES)
    assert check(read, after.workspace, [box]) <= 1.1 * check(plr.updated(after), after.workspace, [box])


@pytest.mark.full
def test_a_map_that_was_empty_fills_the_budget():
    """One leaf says nothing of what a leaf is worth: then all are sought, as in a construction."""
    empty = VisibilityGraph(Workspace(BOUNDS, []), GOAL)
    plr = construct(empty, BOUNDS, leaf="cone", max_bytes=300, certified=True)
    after = empty.with_workspace(empty.workspace.with_obstacles([shapely.box(2, 2, 3, 3)]))
    new, anew = plr.updated(after), construct(after, BOUNDS, leaf="cone", max_bytes=300, certified=True)
    assert plr.num_leaves == 1 and 250 < new.num_bytes <= 300
    assert check(new, after.workspace) < 1.1 * check(anew, after.workspace)


@pytest.mark.parametrize("limits", [{"tolerance": 0.1}, {"max_leaves": 20, "max_bytes": 500}])
def test_limits_of_the_construction_are_kept(oracle, limits):
    plr = construct(oracle, BOUNDS, leaf="cone", certified=True, **limits)
    new = plr.updated(oracle.with_workspace(oracle.workspace.with_obstacles([shapely.box(3.5, 4.5, 4, 5)])))
    assert new.num_leaves <= limits.get("max_leaves", 1_000)
    assert plr.max_error < new.max_error < 1.5 * plr.max_error or new.max_error <= plr.max_error


def test_a_proof_made_afterwards_tells_the_oracle(oracle, plr):
    proven = certify(construct(oracle, BOUNDS, leaf="cone", max_bytes=BYTES), oracle)
    assert proven.updated(oracle).max_error == pytest.approx(proven.max_error, rel=0.3)
    with pytest.raises(ValueError, match=r"max_bytes=3\d\d is too small: one leaf takes"):
        proven.with_label("x" * 290).updated(oracle, max_bytes=310)
    with pytest.raises(ValueError, match="must exceed the label's"):
        proven.with_label("x" * 290).updated(oracle, max_bytes=10)
