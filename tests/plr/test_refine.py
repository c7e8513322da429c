import subprocess
import sys
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import cone, leaf_by_search, walled

import plr_jax.plr._minimize as minimize_module
from plr_jax import Box, VisibilityGraph, construct, cyclic_axis, from_bytes, load, maximum_depth, save, scenes
from plr_jax.plr import _file
from plr_jax.plr._cells import Cells
from plr_jax.plr._faces import sample_faces
from plr_jax.plr._losses import Quantile, eikonal, jumps, quantile, squared
from plr_jax.plr._nodal_tree import shared_faces, tree_of
from plr_jax.plr._planes import encode_planes
from plr_jax.plr._plr import plr_of_leaves
from plr_jax.plr._refine import RefinementInterrupted, refine
from plr_jax.plr._tree import Level

UNIT = Box([0, 0], [1, 1])


def points(n, seed, dim=2):
    return np.random.default_rng(seed).random((n, dim))


@pytest.fixture(scope="module")
def wall():
    """A PLR of the walled square, and points of finite distance."""
    x = points(20_000, 1)
    distance = walled(x)
    free = np.isfinite(distance)
    return construct(walled, UNIT, max_leaves=60), x[free], distance[free]


@pytest.fixture(scope="module")
def wall_faces(wall):
    return sample_faces(wall[0], walled)


def lstsq_twin(plr, x, distance, weight):
    """Slopes and values at the centers of each leaf's own least-squares plane, one leaf at a time."""
    leaf, (lo, hi) = leaf_by_search(plr, x), plr.leaf_boxes
    planes = {}
    for i in np.unique(leaf):
        mine = leaf == i
        if np.count_nonzero(weight[mine]) < 12:
            continue
        root = np.sqrt(weight[mine])
        design = np.concatenate([np.ones((mine.sum(), 1)), x[mine] - (lo + hi)[i] / 2], axis=1)
        planes[i] = np.linalg.lstsq(design * root[:, None], distance[mine] * root, rcond=None)[0]
    return planes


@pytest.mark.parametrize("weighted", [False, True])
def test_the_squared_loss_alone_gives_each_cells_least_squares_plane(wall, weighted):
    plr, x, distance = wall
    weight = np.random.default_rng(0).integers(0, 4, len(x)).astype(float) if weighted else np.ones(len(x))
    refined, report = refine(plr, x, distance, weight=weight if weighted else None, held_out=0)
    twin = lstsq_twin(plr, x, distance, weight)
    assert len(twin) == plr.num_leaves - np.count_nonzero(plr.planes.unreachable) - report.num_kept
    center = np.sum(refined.leaf_boxes, axis=0) / 2
    for i, plane in twin.items():
        np.testing.assert_allclose(refined.slope[i], plane[1:], atol=3e-5)
        np.testing.assert_allclose(refined.intercept[i] + refined.slope[i] @ center[i], plane[0], atol=1e-6)
    assert report.refined.held_out is None
    assert report.refined.training.rms <= report.given.training.rms or weighted


def test_the_descent_finds_the_least_squares_planes_from_another_start(wall):
    """The start is the best for ``error**2``; the planes best for ``(error - 0.005)**2`` lie 0.005 higher."""
    plr, x, distance = wall
    closed, _ = refine(plr, x, distance, held_out=0)
    raised, report = refine(plr, x, distance, loss=_squared_from_above, held_out=0)
    enough = np.bincount(leaf_by_search(plr, x), minlength=plr.num_leaves) >= 12
    x = x[enough[leaf_by_search(plr, x)]]
    np.testing.assert_allclose(np.asarray(raised(x)) - np.asarray(closed(x)), 0.005, atol=1e-4)
    assert report.objective[1] < report.objective[0]


def _squared_from_above(error):
    return (error - 0.005) ** 2


@pytest.mark.parametrize("share", [0.01, 0.05, 0.5])
@pytest.mark.parametrize("bits", [32, 12])
def test_the_share_of_over_estimates_is_the_asked_one_on_new_points(share, bits):
    plr = construct(cone, Box([-1, -1], [1, 1]), max_leaves=40, coefficient_bits=bits)
    x, new = 2 * points(40_000, 2) - 1, 2 * points(40_000, 3) - 1
    refined, report = refine(plr, x, cone(x), loss=quantile(share))
    assert abs(np.mean(np.asarray(refined(new), float) > cone(new)) - share) <= 0.01
    assert abs(report.refined.held_out.over - share) <= 0.01
    assert report.refined.held_out.loss < report.least_squares.held_out.loss


def test_quantiles_of_a_maze_at_two_kilobytes():
    problem = scenes.maze()
    exact = VisibilityGraph(problem.workspace, problem.goals[0])
    plr = construct(exact, problem.workspace.bounds, max_bytes=2048)
    x, new = problem.workspace.sample_free(40_000, 4), problem.workspace.sample_free(20_000, 5)
    distance, expected = exact(x), exact(new)
    for share in (0.01, 0.5):
        refined, report = refine(plr, x, distance, loss=quantile(share), max_bytes=2048)
        assert abs(np.mean(np.asarray(refined(new), float) > expected) - share) <= 0.01
        assert refined.num_bytes <= 2048
        assert report.refined.held_out.loss < report.least_squares.held_out.loss


def test_the_shift_makes_up_for_what_rounding_did():
    """Coarse coefficients err by far more than the planes; the share holds because it is set after rounding."""
    plr = construct(lambda x: x[:, 0] + 2, UNIT, max_leaves=8, coefficient_bits=4)
    x, new = points(20_000, 6), points(20_000, 7)
    refined, report = refine(plr, x, x[:, 0] + 2, loss=quantile(0.05))
    assert np.mean(np.asarray(refined(new), float) > new[:, 0] + 2) <= 0.06
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


def test_faces_are_free_and_each_point_lies_on_both_of_its_leaves(wall, wall_faces):
    plr = wall[0]
    (lo, hi), faces = plr.leaf_boxes, wall_faces
    assert np.isfinite(walled(faces.x)).all() and not plr.planes.unreachable[faces.leaves].any()
    assert (np.abs(faces.u) <= 1 + 1e-12).all()
    for side in range(2):
        x = (lo + hi)[faces.leaves[:, side]] / 2 + faces.u[:, side] * (hi - lo)[faces.leaves[:, side]] / 2
        np.testing.assert_allclose(x, faces.x, atol=1e-12)
    below, above = faces.leaves.T
    touching = hi[below] == lo[above]
    assert (touching.sum(axis=1) >= 1).all() and (below != above).all()
    # The brute-force twin of which leaves meet: all pairs that share a part of a face which is free somewhere.
    u = np.linspace(0.01, 0.99, 50)
    sampled = set(map(tuple, faces.leaves.tolist()))
    for i, j in np.ndindex(len(lo), len(lo)):
        for axis in range(2):
            other = 1 - axis
            start, end = max(lo[i, other], lo[j, other]), min(hi[i, other], hi[j, other])
            if hi[i, axis] == lo[j, axis] and end > start and not plr.planes.unreachable[[i, j]].any():
                x = np.empty((50, 2))
                x[:, axis], x[:, other] = hi[i, axis], start + u * (end - start)
                assert (i, j) in sampled or not np.isfinite(walled(x)).all()


def test_all_pieces_of_faces_are_sampled_alike():
    plr = construct(cone, Box([-1, -1, -1], [1, 1, 1]), max_leaves=40)
    tree = tree_of(plr.cells)
    faces, pieces = sample_faces(plr, cone, num_samples=5), shared_faces(tree)
    pairs, counts = np.unique(faces.leaves, axis=0, return_counts=True)
    assert (counts == 5).all() and len(np.unique(faces.x, axis=0)) == len(faces)
    np.testing.assert_array_equal(pairs, np.stack([pieces.lower, pieces.upper], axis=1))


def test_faces_of_a_file_that_splits_the_same_leaves_in_another_order(monkeypatch):
    quarters = Cells.root(2).split(np.array([1])).split(np.array([0, 0]))
    every = np.array([True, True])
    levels = [
        Level(every[:1], np.array([1])),
        Level(every, np.array([0, 0])),
        Level(np.zeros(4, bool), np.zeros(0, int)),
    ]
    monkeypatch.setattr(_file, "levels_of", lambda cells: (levels, np.arange(4)))
    planes = encode_planes(np.arange(4.0), np.zeros((4, 2)), 32)
    plr = plr_of_leaves(Box([0, 0], [1, 1]), quarters, planes)
    faces = sample_faces(plr, cone, num_samples=1)
    assert (np.abs(faces.u) <= 1).all()
    # Lower left is 0, lower right 1, upper left 2, upper right 3.
    assert sorted(zip(faces.leaves.tolist(), faces.jumps(plr).tolist(), strict=True)) == [
        ([0, 1], 1.0),
        ([0, 2], 2.0),
        ([1, 3], 2.0),
        ([2, 3], 1.0),
    ]


def test_jumps_are_the_limits_of_the_plr_from_both_sides():
    plr = construct(cone, Box([-1, -1, -1], [1, 1, 1]), max_leaves=30)
    faces = sample_faces(plr, cone, num_samples=3, seed=5)
    axis = np.abs(np.abs(faces.u) - 1).sum(axis=1).argmin(axis=1)
    step = 1e-6 * np.eye(3)[axis]
    difference = np.asarray(plr(faces.x + step), float) - np.asarray(plr(faces.x - step), float)
    np.testing.assert_allclose(faces.jumps(plr), difference, atol=1e-5)


def test_points_of_large_weight_are_fitted_better(wall):
    plr, x, distance = wall
    favored = x[:, 0] + x[:, 1] < 0.8
    noisy = distance + 0.1 * np.sin(40 * x[:, 0])
    error = [
        np.abs(np.asarray(refine(plr, x, noisy, weight=w, held_out=0)[0](x[favored]), float) - noisy[favored])
        for w in (np.ones(len(x)), np.where(favored, 1000.0, 1.0))
    ]
    assert np.mean(error[1] ** 2) < np.mean(error[0] ** 2)


def test_huge_weights_are_weights(wall):
    plr, x, distance = wall
    huge, one = (refine(plr, x, distance, weight=np.full(len(x), w), num_steps=1)[0] for w in (1e308, 1.0))
    assert huge.to_bytes() == one.to_bytes()


def test_a_loss_without_a_gradient_leaves_a_finite_objective(wall):
    plr, x, distance = wall
    _, report = refine(plr, x, distance, loss=lambda e: e**2 + jnp.sqrt(0 * e**2), num_steps=50)
    assert report.objective[1] == report.objective[0]


def test_the_same_seed_gives_the_same_file_and_another_seed_another(wall):
    plr, x, distance = wall
    first, second, third = (
        refine(plr, x, distance, loss=quantile(0.1), num_steps=50, seed=seed)[0] for seed in (0, 0, 1)
    )
    assert first.to_bytes() == second.to_bytes() != third.to_bytes()


def test_a_refined_plr_is_an_ordinary_one(wall, tmp_path):
    plr, x, distance = wall
    refined, report = refine(plr, x, distance, loss=quantile(0.05))
    save(refined, tmp_path / "refined.plr")
    again = load(tmp_path / "refined.plr")
    np.testing.assert_array_equal(again(x), refined(x))
    assert again.num_bytes == report.refined.num_bytes == plr.num_bytes
    np.testing.assert_array_equal(refined.cells.depth, plr.cells.depth)
    np.testing.assert_array_equal(refined.cells.position, plr.cells.position)


def test_unreachable_leaves_stay_so_and_leaves_with_few_points_keep_their_plane():
    in_wall = lambda x: np.where((x[:, 0] > 0.5) & (x[:, 1] < 0.5), np.inf, 1 + x[:, 0])  # noqa: E731
    plr = construct(in_wall, UNIT, max_depth=6, should_split=maximum_depth, split=cyclic_axis)
    assert plr.planes.unreachable.any()
    x = points(4000, 9)
    x = x[(x[:, 0] < 0.5) & np.isfinite(in_wall(x))]
    refined, report = refine(plr, x, 3 - x[:, 0], penalties=[eikonal(1e-3), jumps(sample_faces(plr, in_wall), 1.0)])
    np.testing.assert_array_equal(refined.planes.unreachable, plr.planes.unreachable)
    center, half = plr.planes.decode()
    new_center, new_half = refined.planes.decode()
    right = (plr.leaf_boxes[0][:, 0] >= 0.5) & ~plr.planes.unreachable
    assert report.num_kept == right.sum() > 0
    np.testing.assert_array_equal(new_center[right], center[right])
    np.testing.assert_array_equal(new_half[right], half[right])
    assert np.isinf(np.asarray(refined(np.array([[0.99, 0.01]]))))


def test_max_bytes_takes_bits_from_the_coefficients(wall):
    plr, x, distance = wall
    smaller = plr.num_bytes - 200
    refined, _ = refine(plr, x, distance, max_bytes=smaller)
    assert refined.num_bytes <= smaller and refined.planes.bits < 32
    with pytest.raises(ValueError, match="max_bytes=100 is too small for 60 leaves"):
        refine(plr, x, distance, max_bytes=100)


def test_own_losses_and_penalties(wall):
    plr, x, distance = wall

    def flat(planes):
        return 1e3 * jnp.sum(planes.share[:, None] * planes.slope**2)

    refined, _ = refine(plr, x, distance, loss=jnp.abs, penalties=[flat], num_steps=1000)
    many = np.bincount(leaf_by_search(plr, x), minlength=plr.num_leaves) >= 40
    assert np.abs(refined.slope[many]).max() < 0.02


def test_the_report(wall, wall_faces):
    plr, x, distance = wall
    half = np.where(np.arange(len(x)) < 100, np.inf, distance)
    refined, report = refine(plr, x, half, faces=wall_faces)
    assert report.num_unreachable == 100
    total = report.refined.training.num_points + report.refined.held_out.num_points
    assert total == len(x) - 100 and report.refined.held_out.num_points == total // 5
    everywhere = np.asarray(refined(x[100:]), float) - distance[100:]
    shares = [report.refined.training.num_points / total, report.refined.held_out.num_points / total]
    parts = [report.refined.training, report.refined.held_out]
    assert sum(s * e.mean for s, e in zip(shares, parts, strict=True)) == pytest.approx(np.abs(everywhere).mean())
    assert max(e.max for e in parts) == np.abs(everywhere).max()
    assert max(e.max_over for e in parts) == everywhere.max()
    assert sum(s * e.over for s, e in zip(shares, parts, strict=True)) == pytest.approx(np.mean(everywhere > 0))
    assert report.refined.held_out.loss == pytest.approx(report.refined.held_out.rms**2, rel=1e-5)
    assert report.refined.jump_rms == pytest.approx(np.sqrt(np.mean(wall_faces.jumps(refined) ** 2)))
    lines = str(report).splitlines()
    assert lines[1].startswith("given") and "least squares" in lines[2] and lines[3].startswith("refined")
    assert f"{report.refined.held_out.mean:.3g}" in lines[3] and "held-out" in lines[4]


def test_an_interrupt_keeps_the_best_so_far(wall, monkeypatch):
    plr, x, distance = wall
    descend, calls = minimize_module._descend, []

    def interrupted(*arguments):
        calls.append(None)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return descend(*arguments)

    monkeypatch.setattr(minimize_module, "_descend", interrupted)
    with pytest.warns(RefinementInterrupted, match="after 100 of 400"):
        refined, report = refine(plr, x, distance, loss=quantile(0.05))
    assert report.num_steps == 100 and report.objective[1] < report.objective[0]
    assert abs(report.refined.held_out.over - 0.05) < 0.02
    assert from_bytes(refined.to_bytes()).num_leaves == plr.num_leaves


def test_no_warning_without_an_interrupt(wall):
    plr, x, distance = wall
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert refine(plr, x, distance, num_steps=1)[1].num_steps == 50


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x": np.zeros((5, 3))}, r"x must have shape \(n, 2\)"),
        ({"x": np.full((5, 2), 2.0)}, r"All points must lie in .*got \[2.0, 2.0\]"),
        ({"x": np.full((5, 2), np.nan)}, "All points must lie in"),
        ({"distance": np.zeros(4)}, r"distance must have one number a point, shape \(5,\), got \(4,\)"),
        ({"distance": ["a"] * 5}, "distance must be numbers"),
        ({"distance": np.ones(5) + 1j}, "distance must be numbers"),
        ({"distance": np.full(5, np.nan)}, "A distance must be a number, or inf"),
        ({"distance": np.full(5, -np.inf)}, "A distance must be a number, or inf"),
        ({"distance": np.full(5, np.inf)}, "No leaf of .* points of positive weight"),
        ({"weight": np.full(5, -1.0)}, "A weight must be finite and >= 0, got -1"),
        ({"weight": np.zeros(3)}, "weight must have one number a point"),
        ({}, "No leaf of .* has 12 points"),
        ({"num_steps": 0}, "num_steps must be an integer >= 1"),
        ({"held_out": 1.0}, "held_out must be a share"),
        ({"max_bytes": 0}, "max_bytes must be an integer >= 1"),
        ({"seed": -1}, "seed must be an integer >= 0"),
    ],
)
def test_bad_arguments_are_named(wall, change, message):
    arguments = {"x": points(5, 0), "distance": np.ones(5), **change}
    with pytest.raises(ValueError, match=message):
        refine(wall[0], **arguments)


@pytest.mark.parametrize(
    "call, message",
    [
        (
            "refine(construct_continuous(cone, box), x, cone(x))",
            "Only a PLR, as construct builds, has planes to move",
        ),
        (
            "refine(construct(cone, box), x, cone(x), loss='quantile')",
            "such as squared or quantile(0.05), got 'quant",
        ),
        ("refine(construct(cone, box), x, cone(x), penalties=eikonal())", "list of functions, such as [eikonal()]"),
    ],
)
def test_arguments_of_another_kind_are_named(call, message):
    """Outside of these tests, where annotations are not enforced."""
    code = f"""
import numpy as np
from plr_jax.plr import construct, construct_continuous, eikonal, refine
x, box = np.random.default_rng(0).random((500, 2)), ([0, 0], [1, 1])
cone = lambda x: np.hypot(*x.T)
{call}
"""
    environment = {"PYTHONPATH": ":".join(sys.path)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert "ValueError" in done.stderr and message in done.stderr


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
    with pytest.raises(ValueError, match="weight of eikonal must be a finite number >= 0, got -1"):
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


def test_double_precision_changes_nothing_but_rounding(wall, wall_faces):
    plr, x, distance = wall
    arguments = {"loss": quantile(0.2), "penalties": [eikonal(1e-3), jumps(wall_faces, 1e-3)], "num_steps": 200}
    single, _ = refine(plr, x, distance, **arguments)
    with jax.enable_x64(True):
        double, _ = refine(from_bytes(plr.to_bytes()), x, distance, **arguments)
    np.testing.assert_allclose(double(x), single(x), atol=1e-4)


def test_the_pinball_loss_by_hand():
    np.testing.assert_allclose(quantile(0.1)(jnp.array([2.0, -2.0, 0.0])), [1.8, 0.2, 0.0], rtol=1e-6)
    np.testing.assert_allclose(squared(jnp.array([2.0, -3.0])), [4.0, 9.0])
