import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import UNIT, leaf_by_search, points

from plr_jax import construct, from_bytes, refine
from plr_jax.plr import RefinementInterrupted, cyclic_axis, eikonal, jumps, maximum_depth, quantile, sample_faces
from plr_jax.plr.refinement import objective as objective_module


def mean_error(plr, x, distance):
    return np.abs(np.asarray(plr(x), float) - distance).mean()


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
    assert len(twin) == plr.num_leaves - np.count_nonzero(plr.unreachable) - report.num_kept
    center = np.sum(refined.leaf_boxes, axis=0) / 2
    for i, plane in twin.items():
        np.testing.assert_allclose(refined.slope[i], plane[1:], atol=3e-5)
        np.testing.assert_allclose(refined.intercept[i] + refined.slope[i] @ center[i], plane[0], atol=1e-6)
    assert report.refined.held_out is None
    assert report.refined.training.rms <= report.given.training.rms or weighted
    # From another start: the planes best for ``(error - 0.005)**2`` lie 0.005 higher.
    raised, report = refine(plr, x, distance, weight=weight, loss=lambda error: (error - 0.005) ** 2, held_out=0)
    x = x[np.isin(leaf_by_search(plr, x), list(twin))]
    np.testing.assert_allclose(np.asarray(raised(x)) - np.asarray(refined(x)), 0.005, atol=1e-4)
    assert report.objective[1] < report.objective[0]


def test_refining_to_other_distances_lowers_the_loss_of_every_leaf_model(plr, samples):
    """The walled square's PLR, moved to a function that is a plane more; in at most so many bytes."""
    x, distance = samples[0], 1.2 * samples[1] + 0.3 * samples[0][:, 0]
    refined, report = refine(plr, x, distance, num_steps=50)
    assert report.refined.held_out.loss < 1e-3 * report.given.held_out.loss
    # Leaves that share values with others, but have few points, resist.
    most = 1.5 if plr.leaf.name == "plane" else 3
    assert report.refined.held_out.mean < most * mean_error(plr, *samples)
    assert refined.leaf == plr.leaf and refined.num_leaves == plr.num_leaves
    np.testing.assert_array_equal(refined.cells.position, plr.cells.position)
    np.testing.assert_array_equal(refined.unreachable, plr.unreachable)
    again = from_bytes(refined.to_bytes())
    assert again.to_bytes() == refined.to_bytes()
    np.testing.assert_array_equal(again(x), refined(x))
    small, _ = refine(plr, *samples, max_bytes=int(0.9 * plr.num_bytes), num_steps=50)
    assert small.num_bytes <= 0.9 * plr.num_bytes and mean_error(small, *samples) < 0.02
    with pytest.raises(ValueError, match=f"max_bytes=60 is too small for {plr.num_leaves} leaves"):
        refine(plr, *samples, max_bytes=60, num_steps=50)


def test_refining_to_its_own_distances_does_no_harm_where_points_are_few(plr, samples):
    """Once a smooth PLR, whose leaves share slopes, erred twenty times more: its small leaves were flung about."""
    x, distance = (part[:6000] for part in samples)
    before = np.abs(np.asarray(plr(samples[0])) - samples[1])
    refined, _ = refine(plr, x, distance, num_steps=50, held_out=0)
    after = np.abs(np.asarray(refined(samples[0])) - samples[1])
    assert after.mean() < 1.15 * before.mean() and after.max() < 2 * before.max()


def test_a_share_of_over_estimates_for_every_leaf_model(plr, samples):
    _, report = refine(plr, *samples, loss=quantile(0.05), num_steps=200)
    assert abs(report.refined.held_out.over - 0.05) < 0.02
    assert report.refined.held_out.loss < 0.5 * report.least_squares.held_out.loss
    assert report.objective[1] < report.objective[0]


def test_points_of_large_weight_are_fitted_better_and_huge_weights_are_weights(wall):
    plr, x, distance = wall
    favored = x[:, 0] + x[:, 1] < 0.8
    noisy = distance + 0.1 * np.sin(40 * x[:, 0])
    error = [
        np.abs(np.asarray(refine(plr, x, noisy, weight=w, held_out=0)[0](x[favored]), float) - noisy[favored])
        for w in (np.ones(len(x)), np.where(favored, 1000.0, 1.0))
    ]
    assert np.mean(error[1] ** 2) < np.mean(error[0] ** 2)
    huge, one = (refine(plr, x, distance, weight=np.full(len(x), w), num_steps=1)[0] for w in (1e308, 1.0))
    assert huge.to_bytes() == one.to_bytes()


def test_a_loss_without_a_gradient_leaves_a_finite_objective(wall):
    _, report = refine(*wall, loss=lambda e: e**2 + jnp.sqrt(0 * e**2), num_steps=50)
    assert report.objective[1] == report.objective[0]


def test_the_same_seed_gives_the_same_file_and_another_seed_another(wall):
    """Whatever promotion of types and precision are set; in 64 bits but for rounding."""
    faces = sample_faces(wall[0], lambda x: np.ones(len(x)))
    options = {"loss": quantile(0.2), "penalties": [eikonal(1e-3), jumps(faces, 1e-3)], "num_steps": 50}
    single, other = (refine(*wall, **options, seed=seed)[0] for seed in (0, 1))
    with jax.numpy_dtype_promotion("strict"):
        strict, _ = refine(*wall, **options)
    assert single.to_bytes() == strict.to_bytes() != other.to_bytes()
    with jax.enable_x64(True):
        double, _ = refine(from_bytes(wall[0].to_bytes()), *wall[1:], **options)
    np.testing.assert_allclose(double(wall[1]), single(wall[1]), atol=1e-4)


def test_unreachable_leaves_stay_so_and_leaves_with_few_points_keep_their_plane():
    in_wall = lambda x: np.where((x[:, 0] > 0.5) & (x[:, 1] < 0.5), np.inf, 1 + x[:, 0])  # noqa: E731
    plr = construct(in_wall, UNIT, max_depth=6, should_split=maximum_depth, split=cyclic_axis)
    assert plr.unreachable.any()
    x = points(4000, 9)
    x = x[(x[:, 0] < 0.5) & np.isfinite(in_wall(x))]
    refined, report = refine(plr, x, 3 - x[:, 0], penalties=[eikonal(1e-3), jumps(sample_faces(plr, in_wall), 1.0)])
    np.testing.assert_array_equal(refined.unreachable, plr.unreachable)
    right = (plr.leaf_boxes[0][:, 0] >= 0.5) & ~plr.unreachable
    assert report.num_kept == right.sum() > 0
    for new, old in zip(refined.stored.decode(), plr.stored.decode(), strict=True):
        np.testing.assert_array_equal(new[right], old[right])
    assert np.isinf(np.asarray(refined(np.array([[0.99, 0.01]]))))


def test_the_report(wall, wall_faces):
    plr, x, distance = wall
    half = np.where(np.arange(len(x)) < 100, np.inf, distance)
    refined, report = refine(plr, x, half, faces=wall_faces)
    assert report.num_unreachable == 100 and report.refined.num_bytes == refined.num_bytes == plr.num_bytes
    parts = [report.refined.training, report.refined.held_out]
    total = sum(part.num_points for part in parts)
    assert total == len(x) - 100 and parts[1].num_points == total // 5
    everywhere = np.asarray(refined(x[100:]), float) - distance[100:]
    means = {name: sum(p.num_points * getattr(p, name) for p in parts) / total for name in ("mean", "over")}
    assert means == pytest.approx({"mean": np.abs(everywhere).mean(), "over": np.mean(everywhere > 0)})
    assert max(e.max for e in parts) == np.abs(everywhere).max()
    assert max(e.max_over for e in parts) == everywhere.max()
    assert parts[1].loss == pytest.approx(parts[1].rms ** 2, rel=1e-5)
    assert report.refined.jump_rms == pytest.approx(np.sqrt(np.mean(wall_faces.jumps(refined) ** 2)))
    lines = str(report).splitlines()
    assert lines[1].startswith("given") and "least squares" in lines[2] and lines[3].startswith("refined")
    assert f"{parts[1].mean:.3g}" in lines[3] and "held-out" in lines[4]


@pytest.mark.filterwarnings("error")
def test_an_interrupt_keeps_the_best_so_far_and_without_one_nothing_is_warned_of(wall, monkeypatch):
    plr, x, distance = wall
    assert refine(plr, x, distance, num_steps=1)[1].num_steps == 50
    descend, calls = objective_module._descend, []

    def interrupted(*arguments):
        calls.append(None)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return descend(*arguments)

    monkeypatch.setattr(objective_module, "_descend", interrupted)
    with pytest.warns(RefinementInterrupted, match="after 100 of 400"):
        refined, report = refine(plr, x, distance, loss=quantile(0.05))
    assert report.num_steps == 100 and report.objective[1] < report.objective[0]
    assert abs(report.refined.held_out.over - 0.05) < 0.02
    assert from_bytes(refined.to_bytes()).num_leaves == plr.num_leaves


def test_masked_distances_are_left_out_as_infinite_ones_are(wall):
    plr, x, distance = wall
    far = distance > np.median(distance)
    masked, infinite = np.ma.masked_array(np.where(far, 0.0, distance), far), np.where(far, np.inf, distance)
    refined = [refine(plr, x, values, num_steps=60) for values in (masked, infinite)]
    assert refined[0][0].to_bytes() == refined[1][0].to_bytes()
    assert refined[0][1].num_unreachable == far.sum()


@pytest.mark.usefixtures("unchecked_types")
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
        ({"distance": np.ma.masked_less(np.ones(5), 2)}, "No leaf of .* points of positive weight"),
        ({"weight": np.ma.masked_less(np.ones(5), 2)}, "weight must be numbers .* some are masked"),
        ({"weight": np.full(5, -1.0)}, "A weight must be finite and >= 0, got -1"),
        ({"weight": np.zeros(3)}, "weight must have one number a point"),
        ({}, "No leaf of .* has 12 points"),
        ({"num_steps": 0}, "num_steps must be an integer >= 1"),
        ({"held_out": 1.0}, "held_out must be a share"),
        ({"max_bytes": 0}, "max_bytes must be an integer >= 1"),
        ({"seed": -1}, "seed must be an integer >= 0"),
        ({"plr": np.hypot}, "Only a PLR, as construct builds, can be refined"),
        ({"loss": "quantile"}, r"such as squared or quantile\(0.05\), got 'quantile'"),
        ({"penalties": eikonal()}, r"list of functions, such as \[eikonal\(\)\]"),
    ],
)
def test_bad_arguments_are_named(wall, change, message):
    with pytest.raises(ValueError, match=message):
        refine(**({"plr": wall[0], "x": points(5, 0), "distance": np.ones(5)} | change))
