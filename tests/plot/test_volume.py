import numpy as np
import pytest
from matplotlib.image import imread

from plr_jax import plot
from plr_jax.plot._volume import _surface

ROOM = np.ones((4, 3, 5), bool)
ROOM[1, 1, 1:3] = False


def test_a_surface_is_made_of_the_faces_between_blocked_and_free_voxels():
    faces = _surface(ROOM)
    assert len(faces) == 2 + 4 * 2
    np.testing.assert_array_equal(faces.min(axis=(0, 1)), [1, 1, 1])
    np.testing.assert_array_equal(faces.max(axis=(0, 1)), [2, 2, 3])
    # Twice the area of each leads outward, and the volume within is that of two voxels.
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    np.testing.assert_array_equal(np.abs(normals).sum(axis=1), 1)
    assert np.sum(normals * faces.mean(axis=1)) == 3 * 2
    random = np.random.default_rng(0).random((5, 4, 6)) < 0.5
    changes = sum(np.count_nonzero(np.diff(random.astype(int), axis=axis)) for axis in range(3))
    assert len(_surface(random)) == changes


def test_faces_of_the_bounds_are_left_out_so_that_a_room_is_open():
    closed = np.zeros((4, 4, 4), bool)
    closed[1:3, 1:3, 1:3] = True
    assert len(_surface(closed)) == 6 * 4 and len(_surface(np.zeros((2, 2, 2), bool))) == 0


def test_blocked_voxels_paths_and_goal_are_where_they_are(tmp_path):
    bounds, paths = ((0, 0, -1), (8, 6, 9)), [[[0, 0, 0], [8, 6, 9]], np.array([[1, 1, 1.0]])]
    ax = plot.plot_volume(ROOM, bounds=bounds, paths=paths, goal=(8, 6, 9))
    assert (ax.get_xlim(), ax.get_ylim(), ax.get_zlim()) == ((0, 8), (0, 6), (-1, 9))
    assert (ax.get_xlabel(), ax.get_zlabel()) == ("x (workspace units)", "z (workspace units)")
    drawn = [np.transpose(line.get_data_3d()).tolist() for line in ax.lines]
    assert drawn == [paths[0], paths[0][:1], [[1, 1, 1]], [[1, 1, 1]], [[8, 6, 9]]]
    assert ax.lines[-1].get_marker() == "*"
    plot.save(ax, tmp_path / "volume.png")
    assert imread(tmp_path / "volume.png")[..., :3].std() > 0.02
    again = plot.plot_volume(np.ones((2, 2, 2), bool), ax)
    assert again is ax and ax.get_xlim() == (0, 2)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("free", "options", "message"),
    [
        (ROOM[0], {}, r"free must be booleans of 3 axes.*got bool of shape \(3, 5\)"),
        (ROOM.astype(int), {}, "free must be booleans of 3 axes.*got int64"),
        (ROOM[:0], {}, r"at least one free voxel, got none in shape \(0, 3, 5\)"),
        (np.indices((30, 30, 30)).sum(axis=0) % 2 == 0, {}, r"have 78,300 faces, more than 50,000: .*free\[::2, ::2"),
        (ROOM, {"bounds": ((0, 0), (1, 1))}, "The bounds must have 3 axes"),
        (ROOM, {"paths": [[[0, 0, 0]], [[1, 2]]]}, r"path 1 must have shape \(n, 3\)"),
        (ROOM, {"paths": [[[0, 0, np.nan]]]}, "path 0 must have finite coordinates"),
        (ROOM, {"paths": [np.zeros((0, 3))]}, "path 0 must have finite coordinates and a step"),
        (ROOM, {"goal": (1, 2)}, r"goal must be one point of shape \(3,\)"),
    ],
)
def test_a_callers_mistakes(free, options, message):
    with pytest.raises(ValueError, match=message):
        plot.plot_volume(free, **options)
