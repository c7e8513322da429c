import itertools

import numpy as np
import pytest
import shapely
from space_helpers import (
    check_classification,
    check_motions,
    keep_clear,
    random_boxes,
    random_workspace,
    rectangle,
    states,
)

from plr_jax import CellState, PlanarArm, Workspace

BLOCKED, FREE, MIXED = CellState
OPEN = Workspace(((-4.0, -4.0), (4.0, 4.0)))


def links_of(arm, q):
    """The twin: one link after the other, by complex numbers, as Shapely lines, one list a link."""
    position, turn, links = np.full(len(q), complex(*arm.base)), np.ones(len(q), complex), []
    for length, angle in zip(arm.lengths, q.T, strict=True):
        turn = turn * np.exp(1j * angle)
        after = position + length * turn
        ends = np.stack([position, after], axis=1)
        links.append(shapely.linestrings(np.stack([ends.real, ends.imag], axis=2)))
        position = after
    return links


def twin(arm):
    def is_free(q):
        links = links_of(arm, q)
        free = np.all([keep_clear(arm.workspace, link, arm.width / 2) for link in links], axis=0)
        if arm.self_collision:
            for a, b in itertools.combinations(range(len(links)), 2):
                free &= (b - a < 2) | (shapely.distance(links[a], links[b]) >= arm.width - 1e-8)
        return free

    return is_free


def random_arm(seed, joints, width=0.0, self_collision=False):
    """An arm on a base with room, in a random workspace."""
    workspace, rng = random_workspace(seed), np.random.default_rng(seed)
    base = workspace.sample_free(200, seed)
    base = base[np.argmax(workspace.clearance(base))]
    return PlanarArm(workspace, rng.uniform(1.0, 2.0, joints) / joints, base, width, self_collision)


def test_angles_are_relative_to_the_link_before():
    arm = PlanarArm(OPEN, [2, 1], (0.5, 0))
    q = np.array([[0, 0], [np.pi / 2, 0], [np.pi / 2, -np.pi / 2], [0, np.pi]])
    expected = [[[0.5, 0], [2.5, 0], [3.5, 0]], [[0.5, 0], [0.5, 2], [0.5, 3]], [[0.5, 0], [0.5, 2], [1.5, 2]]]
    expected.append([[0.5, 0], [2.5, 0], [1.5, 0]])
    np.testing.assert_allclose(arm.forward(q), expected, atol=1e-12)


def test_a_wall_before_the_tip_blocks_the_angles_toward_it():
    wall = Workspace(OPEN.bounds, [rectangle(2.5, -1, 2.501, 1)])
    arm = PlanarArm(wall, [2, 1], (0, 0))
    # Straight ahead crosses it; the lower arm up keeps clear; in between, some do.
    boxes = [((-0.05, -0.05), (0.05, 0.05)), ((-0.05, 1.5), (0.05, 1.7)), ((-0.05, 0), (0.05, 1.6))]
    assert states(arm, *boxes) == [BLOCKED, FREE, MIXED]
    # Beyond the end of the wall.
    assert states(arm, ((0.5, -0.01), (0.55, 0.01)), ((-np.pi, -np.pi), (np.pi, np.pi))) == [FREE, MIXED]
    assert arm.is_free([[0, 0], [0, 1.6], [0.5, 0]]).tolist() == [False, True, True]


def test_walls_that_touch_block_together_and_the_bounds_are_walls():
    arm = PlanarArm(Workspace(OPEN.bounds, [rectangle(1, -1, 3, 0), rectangle(1, 0, 3, 1)]), [2], (0, 0))
    assert states(arm, ((-0.2,), (0.2,)), ((1.0,), (2.0,))) == [BLOCKED, FREE]
    arm = PlanarArm(OPEN, [3, 2], (0, 0))
    assert states(arm, ((-0.1, -0.1), (0.1, 0.1)), ((-0.1, 2.5), (0.1, 2.7))) == [BLOCKED, FREE]


def test_wide_links_keep_half_their_width_off():
    wall = Workspace(OPEN.bounds, [rectangle(1, 0.3, 2, 0.6)])
    q = np.zeros((1, 1))
    assert [PlanarArm(wall, [2.5], (0, 0), width).is_free(q)[0] for width in (0, 0.5, 0.6, 0.61)] == [True] * 3 + [
        False
    ]
    assert states(PlanarArm(wall, [2.5], (0, 0), 0.5), ((-0.01,), (0.01,)), ((0.03,), (0.2,))) == [FREE, MIXED]
    assert states(PlanarArm(wall, [2.5], (0, 0), 0.8), ((-0.01,), (0.01,))) == [BLOCKED]


def test_links_that_are_no_neighbors_keep_off_one_another():
    folded = np.array([[0.0, 2 * np.pi / 3, 2 * np.pi / 3]])  # a triangle: the tip is back at the base
    arm = PlanarArm(OPEN, [1, 1, 1], (0, 0), 0.1, self_collision=True)
    assert not arm.is_free(folded)[0] and PlanarArm(OPEN, [1, 1, 1], (0, 0), 0.1).is_free(folded)[0]
    assert states(arm, (folded[0] - 0.01, folded[0] + 0.01), ((-3, -1, -1), (3, 1, 1))) == [BLOCKED, MIXED]
    assert states(arm, ((-9, -0.1, -0.1), (9, 0.1, 0.1))) == [
        MIXED
    ]  # for the bounds; how the base turns is no matter
    small = PlanarArm(OPEN, [0.1, 0.1, 0.1], (0, 0), 0.02, self_collision=True)
    assert states(small, ((-9, -0.1, -0.1), (9, 0.1, 0.1))) == [FREE]


@pytest.mark.parametrize(
    ("seed", "joints", "width", "own"),
    [(0, 1, 0, 0), (0, 2, 0, 0), (1, 2, 0.1, 0), (0, 3, 0.05, 0), (1, 3, 0.1, 1), (2, 2, 0.08, 0)],
)
def test_samples_agree_with_what_is_proven(seed, joints, width, own):
    arm = random_arm(seed, joints, width, bool(own))
    lo, hi = random_boxes(np.random.default_rng(seed), arm.domain, 500, deepest=8)
    state = check_classification(arm, twin(arm), lo, hi, {1: 33, 2: 9, 3: 5}[joints])
    assert set(state) == set(CellState)
    for turns in (-2, 1):
        check_classification(arm, twin(arm), lo + 2 * np.pi * turns, hi + 2 * np.pi * turns, 3)


@pytest.mark.full
@pytest.mark.parametrize(("joints", "width", "own"), [(2, 0, False), (2, 0.1, False), (4, 0.1, True)])
def test_small_boxes_are_told(joints, width, own):
    """Of boxes a thousandth of a radian wide most are free or blocked."""
    arm = random_arm(1, joints, width, own)
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (400, joints))
    state, free = arm.classify(q - 5e-4, q + 5e-4), twin(arm)(q)
    assert (state == MIXED).mean() < 0.1 and (state[free] != BLOCKED).all() and (state[~free] != FREE).all()
    assert (arm.is_free(q) == free).all() and len(set(free)) == 2


@pytest.mark.parametrize(("joints", "width", "own"), [(1, 0, False), (2, 0, False), (3, 0.1, True)])
def test_motions_are_free_where_their_samples_are(joints, width, own):
    arm = random_arm(3, joints, width, own)
    rng = np.random.default_rng(3)
    q0 = rng.uniform(-4, 4, (400, joints))
    q1 = q0 + rng.uniform(-1.5, 1.5, (400, joints))
    proven, sampled = check_motions(arm, twin(arm), q0, q1, 129)
    assert (sampled & ~proven).sum() <= 4 and proven.sum() > 10


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((None, [1], (0, 0)), "must be a Workspace"),
        ((OPEN, [], (0, 0)), "lengths"),
        ((OPEN, [1, 0], (0, 0)), r"must be positive, got \[1.0, 0.0\]"),
        ((OPEN, [1, np.nan], (0, 0)), "finite"),
        ((OPEN, [1], (0, 0, 0)), "base"),
        ((OPEN, [1], (5, 0)), "no room"),
        ((OPEN, [1], (3.9, 0), 0.3), "clearance is 0.1"),
        ((OPEN, [1], (0, 0), -1.0), "width must be a finite number of at least 0"),
        ((OPEN, [1, 1, 1], (0, 0), 0.0, True), "give one above 0"),
    ],
)
def test_bad_input_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        PlanarArm(*arguments)
