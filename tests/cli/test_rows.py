"""Tables of points, which are read in chunks: headers, bad rows, and rows across chunks."""

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.cli import rows as table_rows
from plr_jax.cli.rows import read_points


def read(data, dim=2):
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
    np.testing.assert_array_equal(read(text), [[1, 2], [3, 4]])
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
    np.testing.assert_array_equal(read(text), [[1, 2], [np.nan, np.nan], [3, 4]])
    said = capsys.readouterr().err
    assert said.startswith(f"Warning: p, line {line}: expected 2 comma-separated numbers, got ") and got in said
    assert said.endswith("; the answer is nan.\n") and said.count("\n") == 1 and len(said) < 250


@pytest.mark.parametrize("first", ["0.5;0.5", "1,b", "b,1", "1 2"])
def test_bad_first_row_is_no_header(first, capsys):
    np.testing.assert_array_equal(read(first + "\n1,2\n"), [[np.nan, np.nan], [1, 2]])
    assert "p, line 1" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["nan,1\n1,2", "NaN,1\n1,2", "inf,-inf\n1,2"])
def test_nonfinite_numbers_are_points(text, capsys):
    x = read(text)
    assert len(x) == 2 and not np.isfinite(x[0]).all()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("text", ["", "\n\n", "x,y\n", " \r\n"])
def test_tables_without_points_are_refused(text):
    with pytest.raises(ValueError, match="p has no points: expected 2 comma-separated numbers"):
        read(text)


def test_one_warning_counts_the_bad_rows_of_a_block(capsys):
    read("1,2\n" + "0\n" * 1000)
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
    expected = read(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table_rows, "_BLOCK_BYTES", chunk)
        np.testing.assert_array_equal(read(text), expected)
