"""Arguments of undocumented types raise a ``ValueError`` that names them, never a bare ``TypeError``."""

import jax
import numpy as np
import pytest

import plr_jax as pj
from plr_jax.planners import lifelong, replan
from plr_jax.plr import PLR, NumpyPLR

ROOM = pj.Workspace(((0, 0), (1, 1)))
UNIT = pj.Box((0, 0), (1, 1))
VOXELS = np.ones((2, 2, 2), bool)
ENDS = [[0.1, 0.1]], [[0.9, 0.9]]
TASK = pj.Problem(ROOM, [pj.PointRobot()], *ENDS)

LINE = np.array(ENDS)


def traced(call):
    return lambda: jax.jit(call)(1.0)


def cone(x):
    return np.hypot(*x.T)


def built(**options):
    return pj.construct(cone, UNIT, max_leaves=2, options=pj.BuildOptions(**options))


@pytest.mark.usefixtures("unchecked_types")
def test_argument_of_wrong_type_is_named(tmp_path, monkeypatch):
    for call, message in [
        (lambda: pj.construct(None, UNIT), "distance_fn must be a function, got None"),
        (lambda: built(weight_fn=5), "weight_fn must be a function, got 5"),
        (lambda: built(split=5), "split must be a function, got 5"),
        (lambda: built(should_split="x"), "should_split must be a function, got 'x'"),
        (lambda: built(compute_coefficients=5), "compute_coefficients must be a function, got 5"),
        (lambda: built(margin="x"), "margin must be a fraction from 0 to 1 of a cell's width, got 'x'"),
        (lambda: built(margin=1.5), "margin must be a fraction from 0 to 1"),
        (lambda: built(margin=-0.1), "margin must be a fraction from 0 to 1"),
        (lambda: built(num_samples=10**9), "num_samples must be at most 65,536 a cell, got 1,000,000,000"),
        (
            lambda: pj.save(5, "no.plr"),
            "Only a PLR, a BuildingPLR, a PairPLR, BuildingPairs or GridPairs can be saved, got 5",
        ),
        (lambda: pj.save(built(), 7), "path must be the name of a file, a str or a Path, got 7"),
        (lambda: pj.load(True), "path must be the name of a file, a str or a Path, got True"),
        (lambda: pj.load(built().to_bytes()), r"got \d+ bytes. For the content of a PLR's file use from_bytes"),
        (lambda: pj.load_numpy(memoryview(b"abc")), "got 3 bytes. For the content"),
        (lambda: pj.Solution.load(3), "path must be the name of a file, a str or a Path, got 3"),
        (lambda: pj.plot.animate(TASK, LINE).save(1), "path must be the name of a file, a str or a Path, got 1"),
        (lambda: pj.validate(TASK, pj.bl_plan(TASK)), r"must be an array .*, got Solution\(.*\. Pass its .path"),
        (lambda: pj.validate(LINE, TASK), r"problem must be a Problem, such as .*, got array"),
        (lambda: pj.from_bytes("abc"), "data must be the bytes of a PLR file, got 'abc'"),
        (lambda: NumpyPLR(None), "data must be the bytes of a PLR file, got None; for a path use load_numpy"),
        (lambda: NumpyPLR(built()), r"data must be the bytes .*, got PLR\(.*, for a PLR call plr.numpy\(\)"),
        (lambda: PLR.stack(built()), r"plrs must be a list of PLRs, such as \[plr\], got PLR\("),
        (lambda: PLR.stack([5]), r"plrs must be a list of PLRs, such as \[plr\], got 5 at index 0"),
        (lambda: PLR.stack([]), r"plrs must be a list of PLRs, such as \[plr\], got \[\]"),
        (lambda: pj.Problem(5, [pj.PointRobot()], *ENDS), "workspace must be a Workspace, got 5"),
        (lambda: pj.Problem(ROOM, pj.PointRobot(), *ENDS), r"robots must be a list of robots, got PointRobot\(\)"),
        (lambda: pj.Workspace(ROOM.bounds, squeeze="no"), "squeeze must be True or False, got 'no'"),
        (traced(lambda r: pj.Workspace(UNIT, [[(r, 0), (1, 0), (0, 1)]])), "that JAX traces.*grid_distance"),
        (traced(lambda r: pj.VisibilityGraph(ROOM, (r, r))), "goal must be .*not those that JAX traces"),
        (traced(lambda r: pj.Workspace.from_mask(r > np.zeros((2, 2)))), "not those that JAX traces"),
        (traced(ROOM.inflate), "radius must be .*not those that JAX traces"),
        (lambda: ROOM.inflate("x"), "radius must be a finite number of at least 0, got 'x'"),
        (lambda: ROOM.sample_free(1, None), "seed must be an integer >= 0, got None"),
        (lambda: pj.Workspace.from_mask(VOXELS[0, 0]), r"free\[row, column\], rows along y, must be booleans"),
        (lambda: pj.grid_distance(VOXELS, (1, 1)), r"\(h, w\), rows along y, .*got bool of shape \(2, 2, 2\)"),
        (lambda: pj.construct_grid_pairs(VOXELS[0]).window([1, 1], [1, 1], 1), r"points \(x, y\), \(n, 2\) both"),
        (lambda: pj.Workspace.from_mask(VOXELS), r"got bool of shape \(2, 2, 2\). For volumes, use VoxelSpace"),
        (lambda: pj.GridGraph(VOXELS, (1, 1)), r"got bool of shape \(2, 2, 2\). For volumes, use"),
        (lambda: pj.VisibilityGraph(VOXELS, (1, 1, 1)), r"an array of shape \(2, 2, 2\). For volumes, use"),
        (lambda: pj.VisibilityGraph(VOXELS[0], (1, 1)), r"For pixels, use Workspace.from_mask\(free\)"),
        (lambda: replan(5, None, 0), "problem must be a Problem, such as .*, got 5"),
        (lambda: replan(TASK, None, 0, 5), r"options must be BLOptions\(...\), got 5"),
        (lambda: replan(TASK, None, 0, standing=5), "standing must be indices of the 1 robots, as a list, got 5"),
        (lambda: lifelong(5, cone, 1), "problem must be a Problem, such as .*, got 5"),
        (lambda: lifelong(TASK, 5, 1), "next_goal must be a function, got 5"),
        (lambda: lifelong(TASK, cone, 1, plan=5), "plan must be a function, got 5"),
        (lambda: UNIT.grid("x"), "resolution must be an integer >= 1, got 'x'"),
        (lambda: pj.construct(lambda x: None, UNIT), r"must be real numbers of shape \(192,\), got None"),
        (lambda: pj.Workspace(VOXELS), r"an array of shape \(2, 2, 2\). For volumes, use"),
        (lambda: pj.Roadmap.from_workspace(VOXELS[0], (1, 1), 5), r"For pixels, use Workspace.from_mask\(free\)"),
        (lambda: pj.GridField(VOXELS * 1.0, UNIT), r"grid of 2 axes.*, the last one along x"),
    ]:
        monkeypatch.chdir(tmp_path)
        with pytest.raises(ValueError, match=message):
            call()
        assert not any(tmp_path.iterdir())


@pytest.mark.usefixtures("unchecked_types")
def test_iterables_and_buffers_are_accepted():
    plr = built()
    stacked = PLR.stack(each for each in (plr, plr))
    assert len(stacked.plrs) == 2
    for kind in (bytearray, memoryview):
        assert pj.from_bytes(kind(plr.to_bytes())).to_bytes() == plr.to_bytes()


def test_missing_update_names_construct():
    with pytest.raises(AttributeError, match="immutable: construct a new PLR for a changed map"):
        _ = built().update


@pytest.mark.full
def test_array_axes_are_as_documented():
    """In a room of 5 x 3, a wall from (1, 0) to (2, 2) lies between (0.5, 0.5) and (2.5, 0.5)."""
    rows = np.ones((3, 5), bool)
    rows[:2, 1] = False
    ends = [(0.5, 0.5)], [(2.5, 0.5)]
    for mask, row0 in ((rows, "bottom"), (rows[::-1], "top")):
        room = pj.Workspace.from_mask(mask, row0=row0, tolerance=0)
        np.testing.assert_allclose(pj.VisibilityGraph(room, ends[1][0])(ends[0]), 1 + np.sqrt(10))
    # Six steps from cell to cell lead around the wall: two up, two along it, two down.
    pairs = pj.construct_grid_pairs(pj.GridGraph(rows, connectivity=4))
    np.testing.assert_array_equal(pairs(*ends), [6])
    np.testing.assert_array_equal(pj.grid_distance(rows, np.array(ends[1][0]), moves=4)(np.array(ends[0])), [6])
    np.testing.assert_array_equal(pairs.window(ends[1], ends[0], 1)[0], [[-1, -1, -1], [-1, 6, -1], [-1, 5, -1]])
    voxels = rows.T[..., None]
    np.testing.assert_array_equal(pj.VoxelGraph(voxels, (2.5, 0.5, 0.5), moves=6)([(0.5, 0.5, 0.5)]), [6])
    np.testing.assert_array_equal(pj.VoxelSpace(voxels).domain.hi, [5, 3, 1])
    # A number for each cell: 10 y + x at its lower corner.
    numbers = 1.0 + 10 * np.arange(3)[:, None] + np.arange(5)
    for field in (pj.GridField(numbers, ((0, 0), (5, 3))), pj.RasterCost(numbers, ((0, 0), (5, 3)))):
        np.testing.assert_allclose(field(np.array([(3.5, 0.5), (0.5, 2.5)])), [4, 21])
    layers = np.stack([numbers, numbers + 100])
    np.testing.assert_allclose(pj.GridField(layers, ((0, 0, 0), (5, 3, 2)))([(3.5, 0.5, 1.5)]), 104)
