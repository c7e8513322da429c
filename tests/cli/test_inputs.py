"""Inputs of commands: maps and their options, goals, numbers, and tables of points, which are read in chunks."""

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from plr_jax import scenes
from plr_jax.cli import inputs
from plr_jax.cli.inputs import NamedMap, check_output, parse_goals, read_points


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "1,x", "nan,1", "inf,1", "1e400,1", "1,2;", "1 2"])
def test_goal_must_be_two_finite_numbers(text):
    with pytest.raises(ValueError, match="--goal must be 2 numbers X,Y"):
        parse_goals(["0,0", text])
    np.testing.assert_array_equal(parse_goals(["1, -2.5e1", "0,3"]), [(1, -25), (0, 3)])


@pytest.mark.parametrize(
    ("name", "area", "goal"),
    [
        ("thin_maze", scenes.thin_maze().workspace.free_space.area, scenes.thin_maze().goals[0]),
        ("grid.map", 5, None),
        ("polygons.json", 4.5, None),
        ("maze.json", scenes.maze().workspace.free_space.area, scenes.maze().goals[0]),
        ("MAZE.JSON", scenes.maze().workspace.free_space.area, scenes.maze().goals[0]),
        ("team.json", scenes.four_rooms(2).workspace.free_space.area, None),  # two robots: the user chooses a goal
    ],
)
def test_maps_are_scenes_or_files(name, area, goal, maps, monkeypatch):
    monkeypatch.chdir(maps)
    workspace, found = NamedMap(name, None, {}).read()
    assert workspace.free_space.area == pytest.approx(area)
    assert found is None if goal is None else (found == goal).all()
    assert NamedMap(name, np.eye(2), {}).read()[1].tolist() == [[1, 0], [0, 1]]


def test_labels_name_maps():
    scan = "'a scan.png' --goal=-1.5,2000.0 --resolution=0.05 --drop-specks=4"
    for label in (scan, "maze", """'it'"'"'s.geojson' '--goal=0.0,0.1;-1.0,2.5' --polygons=free"""):
        assert NamedMap.of_label(label).label == label
    named = NamedMap.of_label(scan)
    assert (named.name, named.options) == ("a scan.png", {"resolution": 0.05, "drop_specks": 4})
    np.testing.assert_array_equal(named.goals, [(-1.5, 2e3)])
    for other in ("", "kitchen", "the kitchen", "a.png --goal=x", "a.png --radius", "a.png --frame=1", "a.png 'b"):
        assert NamedMap.of_label(other) is None


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    gray = np.full((4, 6), 200, np.uint8)
    gray[1, 2] = 0
    Image.fromarray(gray).save(folder / "a.png")
    (folder / "scan.yaml").write_text("image: a.png\nresolution: 0.05\norigin: [0, 0, 0]\n")
    return folder


OPTIONS = {"resolution": 0.05, "polygons": "free"}


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("d.txt", {}, r"d\.txt: expected a file that ends in one of \.map, "),
        ("maze", OPTIONS, "maze is a scene, which is read without options, got resolution, polygons"),
        ("maze.json", OPTIONS, r"expected options of .* \(none\), got resolution, polygons\."),
        ("scan.yaml", OPTIONS, r"expected options of .*drop_specks.*, got resolution, polygons\."),
        ("a.png", {"threshold": 0.9}, "No pixel"),
    ],
)
def test_options_of_other_readers_are_refused(name, options, message, maps, pictures, monkeypatch):
    monkeypatch.chdir(pictures if (pictures / name).exists() else maps)
    with pytest.raises(ValueError, match=message):
        NamedMap(name, None, options).read()


def test_outputs_without_permission_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("os.access", lambda path, mode: False)  # the tests may run as root, who may all
    with pytest.raises(ValueError, match="a file that you may write"):
        check_output(tmp_path / "a.json", (".json",))
    check_output(None, (".json",))


def read_table(data, dim=2):
    data = data if isinstance(data, bytes) else data.encode()
    return np.concatenate(list(read_points(io.BytesIO(data), "p", dim)))


@pytest.mark.parametrize(
    "text",
    [
        " 1 , 2 \r\n3,4\r\n",
        '"x","y"\n1,2\n3,4\n',
        "# x y\n1,2\n3,4",
        "x;y\n+1,2e0\n3.,4\n \n\n",
        "\ufeffx,y\n1,2\n3,4",
        "\ufeff1,2\n3,4",
        "\n1,2\n \r\n\n3,4\n",
        "\n \nx1,_y2\n1,2\n3,4",
    ],
)
def test_points_are_read_with_or_without_header(text, capsys):
    np.testing.assert_array_equal(read_table(text), [[1, 2], [3, 4]])
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("text", "line", "got"),
    [
        ("1,2\n3\n3,4", 2, "'3'"),
        ("1,2\n1,2,3\n3,4", 2, "'1,2,3'"),
        ("1,2\n1,b\n3,4", 2, "'1,b'"),
        ("x,y\n1,2\nx,y\n3,4", 3, "'x,y'"),
        ("1,2\n1_0,2\n3,4", 2, "'1_0,2'"),
        (b"1,2\n\xa01,2\n3,4", 2, "'\N{REPLACEMENT CHARACTER}1,2'"),
        ("1,2\n\0,2\n3,4", 2, r"'\x00,2'"),
        ("x,y\n1,2\n" + "9" * 400 + "\n3,4", 3, "9'"),
    ],
)
def test_bad_row_becomes_nan(text, line, got, capsys):
    np.testing.assert_array_equal(read_table(text), [[1, 2], [np.nan, np.nan], [3, 4]])
    said = capsys.readouterr().err
    assert said.startswith(f"Warning: p, line {line}: expected 2 comma-separated numbers, got ") and got in said
    assert said.endswith("; the answer is nan.\n") and said.count("\n") == 1 and len(said) < 250


@pytest.mark.parametrize("first", ["0.5;0.5", "1,b", "b,1", "1 2"])
def test_bad_first_row_is_no_header(first, capsys):
    np.testing.assert_array_equal(read_table(first + "\n1,2\n"), [[np.nan, np.nan], [1, 2]])
    assert "p, line 1" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["nan,1\n1,2", "NaN,1\n1,2", "inf,-inf\n1,2"])
def test_nonfinite_numbers_are_points(text, capsys):
    x = read_table(text)
    assert len(x) == 2 and not np.isfinite(x[0]).all()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("text", ["", "\n\n", "x,y\n", " \r\n"])
def test_tables_without_points_are_refused(text):
    with pytest.raises(ValueError, match="p has no points: expected 2 comma-separated numbers"):
        read_table(text)


def test_one_warning_counts_the_bad_rows_of_a_block(capsys):
    read_table("1,2\n" + "0\n" * 1000)
    said = capsys.readouterr().err
    assert said.endswith("expected 2 comma-separated numbers, got '0'; the answer is nan, as for 999 more rows.\n")
    assert said.count("\n") == 1


@given(
    st.lists(
        st.sampled_from(["1,2", "-3.5e-1, 7", "", "a,b", "1", "nan,0", "\r", "1e400,2", "1_0,2", "é,é", "\x1f1,2"]),
        min_size=1,
    ),
    st.integers(9, 40),
    st.sampled_from(["\n", "\r\n"]),
    st.booleans(),
)
def test_points_do_not_depend_on_chunk_size(rows, chunk, newline, ends):
    text = newline.join(["0,0", *rows]) + newline * ends
    expected = read_table(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(inputs, "_BLOCK_BYTES", chunk)
        np.testing.assert_array_equal(read_table(text), expected)
