import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import UNIT, cone, leaf_by_search, points, walled

from plr_jax import Box
from plr_jax.plr import Plane, construct
from plr_jax.plr.refinement.objective import Quantile, eikonal, jumps, quantile, sample_faces, squared
from plr_jax.plr.refinement.refine import refine


def test_the_pinball_loss_by_hand():
    np.testing.assert_allclose(quantile(0.1)(jnp.array([2.0, -2.0, 0.0])), [1.8, 0.2, 0.0], rtol=1e-6)
    np.testing.assert_allclose(squared(jnp.array([2.0, -3.0])), [4.0, 9.0])


@pytest.mark.parametrize(("share", "bits"), [(0.01, 32), (0.05, 12), (0.5, 32)])
def test_the_share_of_over_estimates_is_the_asked_one_on_new_points(share, bits):
    plr = construct(cone, Box([-1, -1], [1, 1]), max_leaves=60, leaf=Plane(coefficient_bits=bits))
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


@pytest.mark.parametrize(("share", "num_points"), [(1e-4, 2000), (0.05, 90)])
def test_a_share_that_too_few_points_can_vouch_for_is_refused(share, num_points):
    plr, x = construct(cone, UNIT, max_leaves=2), points(num_points, 0)
    with pytest.raises(ValueError, match=r"takes .* points to set the height by, here there are"):
        refine(plr, x, cone(x), loss=quantile(share), num_steps=1)


def test_the_eikonal_penalty_makes_slopes_of_norm_one(wall):
    plr, x, distance = wall
    noisy = distance + 0.02 * np.random.default_rng(3).normal(size=len(x))
    plain, before = refine(plr, x, noisy)
    refined, after = refine(plr, x, noisy, penalties=[eikonal(1.0)])
    many = np.bincount(leaf_by_search(plr, x), minlength=plr.num_leaves) >= 40
    assert np.abs(np.linalg.norm(plain.slope[many], axis=1) - 1).max() > 0.05
    np.testing.assert_allclose(np.linalg.norm(refined.slope[many], axis=1), 1, atol=2e-3)
    assert after.refined.held_out.eikonal_rms < 0.1 * before.refined.held_out.eikonal_rms
    # Noise bends the planes, and a known norm of the slope bends them back.
    smooth, _ = refine(plr, x, noisy, penalties=[eikonal(0.01)])
    assert _mean_error(smooth, x, distance) < _mean_error(plain, x, distance)


def _mean_error(plr, x, distance):
    return np.abs(np.asarray(plr(x), float) - distance).mean()


def test_the_jumps_penalty_lowers_jumps_and_more_of_it_lowers_them_more(wall, wall_faces):
    plr, x, distance = wall
    reports = [
        refine(plr, x, distance, penalties=[jumps(wall_faces, weight)], faces=wall_faces)[1]
        for weight in (0.0, 1.0, 30.0)
    ]
    rms = [report.refined.jump_rms for report in reports]
    assert rms[0] == pytest.approx(reports[0].least_squares.jump_rms, rel=1e-3)
    assert rms[0] > 1.1 * rms[1] > 1.1 * 1.1 * rms[2]
    assert reports[1].refined.training.rms > reports[0].refined.training.rms


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


def test_bad_losses_and_penalties_are_named(wall, wall_faces):
    plr, x, distance = wall
    for loss, message in (
        (jnp.sum, "one number an error"),
        (lambda e: e > 0, "one number an error"),
        (lambda e: e * jnp.nan, "must be finite, got nan"),
        (lambda e: np.square(np.asarray(e)), "computes in NumPy"),
    ):
        with pytest.raises(ValueError, match=message):
            refine(plr, x, distance, loss=loss)
    with pytest.raises(ValueError, match="A penalty must return one number"):
        refine(plr, x, distance, penalties=[lambda planes: planes.center])
    for share in (0, 1, -0.1, np.nan):
        with pytest.raises(ValueError, match="share of over-estimates must be between 0 and 1"):
            refine(plr, x, distance, loss=Quantile(share))
        with pytest.raises(ValueError, match="between 0 and 1"):
            quantile(share)
    with pytest.raises(ValueError, match="weight of eikonal must be a finite number of at least 0, got -1"):
        eikonal(-1)
    with pytest.raises(ValueError, match="weight of jumps"):
        jumps(wall_faces, np.inf)
    with pytest.raises(ValueError, match="num_samples must be an integer >= 1"):
        sample_faces(plr, walled, num_samples=0)
    for other in (construct(cone, UNIT, max_leaves=61), construct(cone, UNIT, max_leaves=3)):
        with pytest.raises(ValueError, match="These faces are not those of PLR"):
            refine(other, x, distance, faces=wall_faces, num_steps=1)
    one_leaf = construct(cone, UNIT, max_leaves=1)
    assert refine(one_leaf, x, distance, faces=sample_faces(one_leaf, cone), num_steps=1)[1].refined.jump_rms is None
    with pytest.raises(ValueError, match="no free face"):
        jumps(sample_faces(one_leaf, cone))
