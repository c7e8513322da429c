import warnings

import numpy as np
import pytest
from cli_helpers import done, mistake, run
from volume_files import VOXELS, stl_files

from plr_jax import ConstructionInterrupted, load, solve_eikonal
from plr_jax.cli._volumes import NamedVolume


@pytest.fixture(scope="module", autouse=True)
def volumes(tmp_path_factory):
    """A folder of volumes, in which the commands run."""
    folder = tmp_path_factory.mktemp("volumes")
    np.save(folder / "hall.npy", np.ones((4, 3, 2), bool))
    np.save(folder / "floor.npy", np.ones((4, 3), bool))
    (folder / "cave.3dmap").write_text(VOXELS)
    (folder / "room.stl").write_bytes(stl_files()[0])
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


def table(text):
    return np.array([[float(number) for number in line.split(",")] for line in text.splitlines()])


def test_a_file_of_a_volume_keeps_its_budget_and_answers_x_y_z_within_proven_bounds():
    said = done("build", "hall.npy", "--goal", "1,1,1", "--max-leaves", 20, "--max-bytes", 200, "--resolution", 0.5)
    plr = load("hall.plr")
    assert 150 < plr.num_bytes <= 200 and plr.label == "hall.npy --goal=1,1,1 --resolution=0.5"
    np.testing.assert_array_equal([plr.domain.lo, plr.domain.hi], [(0, 0, 0), (2, 1.5, 1)])
    assert f"wrote   hall.plr: {plr.num_bytes} bytes; {plr.num_leaves} leaves, depth {plr.depth}\n" in said
    assert f"leaf    continuous: no error above {plr.max_error:.3g}, proven\nbounds  " in said
    assert "in the mean of 20,000 random free points that reach the goal\n" in said
    x = np.random.default_rng(0).uniform(plr.domain.lo, plr.domain.hi, (50, 3))
    rows = "".join(f"{a!r},{b!r},{c!r}\n" for a, b, c in x.tolist())
    answer, lower, upper = table(done("query", "hall.plr", "--bounds", input=rows)).T
    distance = np.linalg.norm(x - 1, axis=1)
    assert (lower <= distance + 1e-6).all() and (distance <= upper + 1e-6).all()
    assert np.abs(answer - distance).max() <= plr.max_error
    assert "has 3 axes, of which no plane is chosen here" in mistake("plot", "hall.plr", "-o", "hall.png")


def test_points_without_a_bound_from_above_are_told():
    said = done("build", "cave.3dmap", "--goal", "6,1.5,3", "--max-leaves", 8, "-o", "cave.plr")
    assert "leaf    continuous: bounds of every leaf, proven" in said and "more --max-bytes or --max-leaves" in said


@pytest.mark.parametrize(
    ("volume", "shape", "lo", "hi"),
    [
        (NamedVolume("hall.npy", "1,1,1"), (4, 3, 2), (0, 0, 0), (4, 3, 2)),
        (NamedVolume("hall.npy", "1,1,1", box="-1,0,0,3,6,2"), (4, 3, 2), (-1, 0, 0), (3, 6, 2)),
        (NamedVolume("floor.npy", ".5,.5", resolution=0.25, radius=0.1), (4, 3), (0, 0), (1, 0.75)),
        (NamedVolume("cave.3dmap", "1,1,1"), (12, 9, 6), (0, 0, 0), (12, 9, 6)),
        (NamedVolume("room.stl", "1,.5,.5", 0.25, enclosed="free"), (13, 4, 6), (-1, 0, 0), (2.25, 1, 1.5)),
        (NamedVolume("room.stl", "1,2,.5", 0.5, "-2,-1,-1,3,3,2"), (10, 8, 6), (-2, -1, -1), (3, 3, 2)),
    ],
)
def test_a_volume_is_read_as_the_options_say(volume, shape, lo, hi):
    if volume.name.endswith(".stl"):
        pytest.importorskip("trimesh")
    space, goal = volume.read()
    np.testing.assert_array_equal([space.domain.lo, space.domain.hi], [lo, hi])
    assert space.free.shape == shape and space.radius == (volume.radius or 0)
    assert space.is_free(goal[None])[0]


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["hall.npy"], "hall.npy has no goal of its own: give one with --goal X,Y,Z."),
        (["hall.npy", "--goal", "1,1"], "--goal must be three numbers X,Y,Z in one argument, such as 3,28,5, got"),
        (["hall.npy", "--goal", "1,1,9"], "goal must be a free configuration"),
        (["hall.npy", "--goal", "1,1,1", "--leaf", "cone", "--max-depth", 9], "is built without --max-depth, --leaf"),
        (["hall.npy", "--goal", "1,1,1", "--enclosed", "free"], "leave out --enclosed"),
        (["hall.npy", "--goal", "1,1,1", "--box", "0,0,1"], "--box must be two corners X,Y,Z,X,Y,Z"),
        (["hall.npy", "--goal", "1,1,1", "--box", "0,0,1,1"], "bounds must have 3 axes, as free has"),
        (["floor.npy", "--goal", "1,1", "--box", "0,0,1,1", "--resolution", 2], "leave out --resolution"),
        (["room.stl", "--goal", "1,1,1"], "room.stl is a mesh: give the side of a voxel with --resolution"),
        (["room.stl", "--goal", "1,1,1", "--resolution", 1, "--enclosed", "no"], "must be blocked or free, got 'no'"),
        (["maze", "--box", "0,0,1,1"], "--box and --enclosed are for volumes, and maze is none"),
        (["none.npy", "--goal", "1,1,1"], "none.npy: No such file or directory"),
    ],
)
def test_mistakes_with_volumes_are_explained(command, message):
    assert message in mistake("build", *command, "-o", "none.plr")


def test_a_budget_that_is_too_small_is_told_with_one_that_is_enough():
    command = ["build", "cave.3dmap", "--goal", "6,1.5,3", "-o", "few.plr", "--max-leaves", 100, "--max-bytes"]
    least = int(mistake(*command, 3).split("allow at least ")[1].removesuffix(".\n"))
    assert f"allow at least {least}." in mistake(*command, least - 1)
    done(*command, least)
    assert load("few.plr").num_bytes <= least


def test_a_mesh_that_leaves_nothing_free_is_told_what_to_do():
    pytest.importorskip("trimesh")
    error = mistake("build", "room.stl", "--goal", "1,.5,.5", "--resolution", 1, "-o", "none.plr")
    assert "--enclosed free leaves those that its surface encloses" in error


def test_a_goal_of_three_arguments_is_told_how_to_be_one():
    result = run("build", "hall.npy", "--goal", "1,", "-2", "0.5")
    assert result.exit_code == 2 and "write --goal 1,-2,0.5" in result.output.replace("\n", " ")


def test_interrupting_keeps_what_there_is_and_ends_with_130(monkeypatch):
    def interrupted(*arguments, **limits):
        warnings.warn("interrupted", ConstructionInterrupted, stacklevel=1)
        return solve_eikonal(*arguments, **limits)

    monkeypatch.setattr("plr_jax.eikonal.solve_eikonal", interrupted)
    result = run("build", "floor.npy", "--goal", "1,1", "-o", "part.plr", "--max-leaves", 4)
    assert (result.exit_code, result.stdout) == (130, "")
    assert result.stderr == f"Interrupted: part.plr holds the {load('part.plr').num_leaves} leaves built so far.\n"
