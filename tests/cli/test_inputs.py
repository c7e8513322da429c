import io

import numpy as np
import pytest

from plr_jax.cli._inputs import parse_goal, parse_points, read_text


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "1,x", "nan,1", "inf,1"])
def test_a_goal_is_two_finite_numbers(text):
    with pytest.raises(ValueError, match="--goal must be two numbers"):
        parse_goal(text)
    np.testing.assert_array_equal(parse_goal("1, -2.5e1"), [1, -25])


@pytest.mark.parametrize(
    "text", ["1,2\n3,4", "1,2\n3,4\n", "x,y\n1,2\n3,4\n\n", " 1 , 2 \r\n3,4\r\n", '"x","y"\n1,2\n3,4\n']
)
def test_points_come_with_or_without_a_header(text):
    np.testing.assert_array_equal(parse_points("p", text, 2), [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2\n\n3,4\n", "p, line 2: .*got ''"),
        ("x,y\n1,2\n3,nan\n", "p, line 3: .*got '3,nan'"),
        ("1,2\n3,inf\n", "p, line 2"),
        ("1,2\n3\n", "p, line 2"),
        ("1,2,3\n", "p, line 1"),
        ("1,b\n1,2\n", "p, line 1"),  # half a number: no header
        ("1,2\n1;2\n", "p, line 2"),
        ("1;2\n1,2\n", "p, line 1"),  # nor numbers apart from each other in another way
        ("1 2\n", "p, line 1"),
        ("nan,nan\n1,2\n", "p, line 1"),
        ("\n1,2\n", "p, line 1"),
        ("x,y\n", "p has no points"),
        ("\n\n", "p has no points"),
    ],
)
def test_broken_points_are_refused_by_line(text, message):
    with pytest.raises(ValueError, match=message):
        parse_points("p", text, 2)


def test_text_comes_from_a_file_or_from_standard_input(tmp_path, monkeypatch):
    (tmp_path / "a.csv").write_bytes("\ufeff1,2\n".encode())  # a byte order mark, as spreadsheets write it
    assert read_text(str(tmp_path / "a.csv")) == (str(tmp_path / "a.csv"), "1,2\n")
    monkeypatch.setattr("sys.stdin", io.StringIO("3,4\n"))
    assert read_text("-") == ("stdin", "3,4\n")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match="is not a text file"):
        read_text(str(tmp_path / "b.csv"))
