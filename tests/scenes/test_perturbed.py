import numpy as np
import pytest

from plr_jax import scenes

SCENES = [scenes.single_door, lambda: scenes.four_rooms(8), lambda: scenes.cross(3), scenes.tangle, scenes.maze]


@pytest.mark.parametrize("make", SCENES)
def test_starts_and_goals_move_a_little_and_nothing_else_does(make):
    problem = make()
    distance = 0.02 if problem.workspace.bounds.width.max() == 1 else 0.1
    variants = [scenes.perturbed(problem, seed, distance) for seed in range(5)]
    for variant in variants:
        assert (variant.workspace, variant.robots) == (problem.workspace, problem.robots)
        assert variant.rotation_weight == problem.rotation_weight
        for name in ("starts", "goals"):
            moved = getattr(variant, name) - getattr(problem, name)
            away = np.linalg.norm(moved[:, :2], axis=1)
            assert ((away > 0) & (away <= distance)).all()
            if problem.dof == 3:
                turns = np.abs(moved[:, 2])
                assert ((turns > 0) & (turns <= distance / problem.robots[0].circumscribed_radius)).all()
    assert len({variant.starts.tobytes() for variant in variants}) == len(variants)


def test_the_same_seed_gives_the_same_variant():
    a, b = (scenes.perturbed(scenes.four_rooms(3), 7) for _ in range(2))
    np.testing.assert_array_equal(a.starts, b.starts)
    np.testing.assert_array_equal(a.goals, b.goals)


@pytest.mark.parametrize("distance", [0, -1.0, np.nan, np.inf])
def test_the_distance_must_be_positive(distance):
    with pytest.raises(ValueError, match="distance must be a positive finite number"):
        scenes.perturbed(scenes.cross(2), 0, distance)
