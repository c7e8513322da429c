import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import UNIT, cone, leaf_by_search, points, quarters_in_another_order, walled

from plr_jax import construct, refine
from plr_jax.plr import Plane, eikonal, jumps, quantile, sample_faces, squared
from plr_jax.plr._plr import plr_of_leaves
from plr_jax.plr.partition.cells import tree_of
from plr_jax.plr.partition.faces import shared_faces
from plr_jax.plr.refinement.objective import Quantile


def mean_error(plr, x, distance):
    return np.abs(np.asarray(plr(x), float) - distance).mean()


def test_the_pinball_loss_by_hand():
    np.testing.assert_allclose(quantile(0.1)(jnp.array([2.0, -2.0, 0.0])), [1.8, 0.2, 0.0], rtol=1e-6)
    np.testing.assert_allclose(squared(jnp.array([2.0, -3.0])), [4.0, 9.0])


@pytest.mark.parametrize(("share", "bits"), [(0.01, 32), (0.05, 12), (0.5, 32)])
def test_the_share_of_over_estimates_is_the_asked_one_on_new_points(share, bits):
    plr = construct(cone, ([-1, -1], [1, 1]), max_leaves=60, leaf=Plane(coefficient_bits=bits))
    x, new = 2 * points(25_000, 2) - 1, 2 * points(40_000, 3) - 1
    refined, report = refine(plr, x, cone(x), loss=quantile(share))
    tolerance = min(0.01, 4 * np.sqrt(share / 4_000))  # of so many points that set the height
    assert abs(np.mean(np.asarray(refined(new), float) > cone(new)) - share) <= tolerance
    assert abs(report.refined.held_out.over - share) <= tolerance
    assert report.refined.held_out.loss < report.least_squares.held_out.loss


def test_the_shift_makes_up_for_what_rounding_did():
    """Coarse coefficients err by far more than the planes; the share holds because it is set after rounding."""
    plr = construct(cone, UNIT, max_leaves=60, leaf=Plane(coefficient_bits=4))
    x, new = points(25_000, 6), points(40_000, 7)
    refined, report = refine(plr, x, cone(x), loss=quantile(0.05), num_steps=100)
    assert np.mean(np.asarray(refined(new), float) > cone(new)) <= 0.06
    assert report.shift != 0


def test_the_eikonal_penalty_makes_slopes_of_norm_one(wall):
    """Noise bends the planes, and a known norm of the slope bends them back."""
    plr, x, distance = wall
    noisy = distance + 0.02 * np.random.default_rng(3).normal(size=len(x))
    plain, before = refine(plr, x, noisy)
    refined, after = refine(plr, x, noisy, penalties=[eikonal(1.0)])
    many = np.bincount(leaf_by_search(plr, x), minlength=plr.num_leaves) >= 40
    assert np.abs(np.linalg.norm(plain.slope[many], axis=1) - 1).max() > 0.05
    np.testing.assert_allclose(np.linalg.norm(refined.slope[many], axis=1), 1, atol=2e-3)
    assert after.refined.held_out.eikonal_rms < 0.1 * before.refined.held_out.eikonal_rms
    smooth, _ = refine(plr, x, noisy, penalties=[eikonal(0.01)])
    assert mean_error(smooth, x, distance) < mean_error(plain, x, distance)


def test_penalties_of_every_leaf_model(plr, samples):
    """Each lowers what it penalizes, and the loss pays for it."""
    faces = sample_faces(plr, walled, num_samples=2)
    plain, before = refine(plr, *samples, faces=faces, num_steps=50)
    for penalty, name in ((eikonal(1.0), "eikonal_rms"), (jumps(faces, 10.0), "jump_rms")):
        _, after = refine(plr, *samples, penalties=[penalty], faces=faces, num_steps=100)
        stages = [report.refined if name == "jump_rms" else report.refined.training for report in (before, after)]
        assert getattr(stages[1], name) < 0.8 * getattr(stages[0], name)
        assert after.refined.training.loss > before.refined.training.loss
    if plr.leaf.name != "plane":  # it jumps beside walls alone, where a face is nearly all wall
        assert np.quantile(np.abs(faces.jumps(plain)), 0.95) < 1e-9


def test_two_planes_can_be_joined_without_a_jump():
    """V is 0 left of the middle and 1 right of it: with a huge weight the best planes meet, at 1/2 by symmetry."""

    def stair(x):
        return (x[:, 0] > 0.5) * 1.0

    plr = construct(stair, UNIT, max_leaves=2)
    faces = sample_faces(plr, cone)
    np.testing.assert_allclose(faces.jumps(plr), 1, atol=0.02)  # samples on the face itself count a little
    x = points(4000, 8)
    noisy = stair(x) + 0.05 * np.random.default_rng(0).normal(size=len(x))
    refined, _ = refine(plr, x, noisy, penalties=[jumps(faces, 1e3)], num_steps=2000)
    assert np.abs(faces.jumps(refined)).max() < 0.01
    # Left of the middle the least-squares line through (1/2, 1/2): slope 3/2 (minimize the integral of its square).
    np.testing.assert_allclose(refined.slope, [[1.5, 0], [1.5, 0]], atol=0.1)


def test_own_losses_and_penalties(wall):
    plr, x, distance = wall

    def flat(planes):
        return 1e3 * jnp.sum(planes.share[:, None] * planes.slope**2)

    refined, _ = refine(plr, x, distance, loss=jnp.abs, penalties=[flat], num_steps=1000)
    many = np.bincount(leaf_by_search(plr, x), minlength=plr.num_leaves) >= 40
    assert np.abs(refined.slope[many]).max() < 0.02


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"loss": jnp.sum}, "one number an error"),
        ({"loss": lambda e: e > 0}, "one number an error"),
        ({"loss": lambda e: e * jnp.nan}, "must be finite, got nan"),
        ({"loss": lambda e: np.square(np.asarray(e))}, "computes in NumPy"),
        ({"penalties": [lambda planes: planes.center]}, "A penalty must return one number"),
        *(({"loss": Quantile(share)}, "share of over-estimates must be between 0 and 1") for share in (0, 1, np.nan)),
    ],
)
def test_bad_losses_and_penalties_are_named(wall, wall_faces, options, message):
    arguments = dict(zip(("plr", "x", "distance"), wall, strict=True))
    with pytest.raises(ValueError, match=message):
        refine(**(arguments | options), faces=wall_faces, num_steps=1)


def test_bad_shares_weights_and_faces_are_named(wall_faces):
    (one_leaf, other), x, y = (construct(cone, UNIT, max_leaves=n) for n in (1, 61)), points(90, 0), points(2000, 0)
    none = sample_faces(one_leaf, cone)
    assert refine(one_leaf, x, cone(x), faces=none, num_steps=1)[1].refined.jump_rms is None
    for call, message in (
        (lambda: quantile(0), "between 0 and 1"),
        (
            lambda: refine(one_leaf, x, cone(x), loss=quantile(0.05)),
            r"takes .* points to set the height by, here there",
        ),
        (
            lambda: refine(one_leaf, y, cone(y), loss=quantile(1e-4)),
            r"takes .* points to set the height by, here there",
        ),
        (lambda: refine(one_leaf, y, cone(y), faces=wall_faces), "These faces are not those of PLR"),
        (lambda: refine(other, y, cone(y), faces=wall_faces), "These faces are not those of PLR"),
        (lambda: eikonal(-1), "weight of eikonal must be a finite number of at least 0, got -1"),
        (lambda: jumps(wall_faces, np.inf), "weight of jumps"),
        (lambda: jumps(none), "no free face"),
        (lambda: sample_faces(one_leaf, walled, num_samples=0), "num_samples must be an integer >= 1"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


# Faces.


def test_faces_are_free_and_each_point_lies_on_both_of_its_leaves(wall, wall_faces):
    plr = wall[0]
    (lo, hi), faces = plr.leaf_boxes, wall_faces
    assert np.isfinite(walled(faces.x)).all() and not plr.unreachable[faces.leaves].any()
    assert (np.abs(faces.u) <= 1 + 1e-12).all()
    for side in range(2):
        x = (lo + hi)[faces.leaves[:, side]] / 2 + faces.u[:, side] * (hi - lo)[faces.leaves[:, side]] / 2
        np.testing.assert_allclose(x, faces.x, atol=1e-12)
    below, above = faces.leaves.T
    assert (hi[below] == lo[above]).any(axis=1).all() and (below != above).all()
    # The brute-force twin of which leaves meet: all pairs that share a part of a face which is free somewhere.
    u = np.linspace(0.01, 0.99, 50)
    sampled = set(map(tuple, faces.leaves.tolist()))
    for i, j, axis in np.ndindex(len(lo), len(lo), 2):
        other = 1 - axis
        start, end = max(lo[i, other], lo[j, other]), min(hi[i, other], hi[j, other])
        if hi[i, axis] == lo[j, axis] and end > start and not plr.unreachable[[i, j]].any():
            x = np.empty((50, 2))
            x[:, axis], x[:, other] = hi[i, axis], start + u * (end - start)
            assert (i, j) in sampled or not np.isfinite(walled(x)).all()


def test_all_pieces_of_faces_are_sampled_alike_and_jumps_are_the_limits_from_both_sides():
    plr = construct(cone, ([-1, -1, -1], [1, 1, 1]), max_leaves=40)
    faces, pieces = sample_faces(plr, cone, num_samples=5), shared_faces(tree_of(plr.cells))
    pairs, counts = np.unique(faces.leaves, axis=0, return_counts=True)
    assert (counts == 5).all() and len(np.unique(faces.x, axis=0)) == len(faces)
    np.testing.assert_array_equal(pairs, np.stack([pieces.lower, pieces.upper], axis=1))
    step = 1e-6 * np.eye(3)[np.abs(np.abs(faces.u) - 1).sum(axis=1).argmin(axis=1)]
    difference = np.asarray(plr(faces.x + step), float) - np.asarray(plr(faces.x - step), float)
    np.testing.assert_allclose(faces.jumps(plr), difference, atol=1e-5)


def test_faces_of_a_file_that_splits_the_same_leaves_in_another_order():
    plr = plr_of_leaves(quarters_in_another_order())
    faces = sample_faces(plr, cone, num_samples=1)
    assert (np.abs(faces.u) <= 1).all()
    # Lower left is 0, lower right 1, upper left 2, upper right 3.
    found = sorted(zip(faces.leaves.tolist(), faces.jumps(plr).tolist(), strict=True))
    assert found == [([0, 1], 1.0), ([0, 2], 2.0), ([1, 3], 2.0), ([2, 3], 1.0)]
