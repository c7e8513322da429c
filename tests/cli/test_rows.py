"""Tables of points, which are read in chunks: headers, bad rows, and rows across chunks."""

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.cli import rows as table_rows
from plr_jax.cli.rows import open_table, read_points


def read(data, dim=2, strict=False):
    data = data if isinstance(data, bytes) else data.encode()
    return np.concatenate(list(read_points(io.BytesIO(data), "p", dim, strict)))


@pytest.mark.parametrize(
    "text",
    [
        " 1 , 2 \r\n3,4\r\n",
        '"x","y"\n1,2\n3,4\n',
        "# x y\n1,2\n3,4",
        "x;y\n+1,2e0\n3.,4\n \n\n",
        "\ufeffx,y\n1,2\n3,4",
        "\n1,2\n \r\n\n3,4\n",
        "\n \nx,y\n1,2\n3,4",
    ],
)
def test_points_are_read_with_or_without_header(text):
    np.testing.assert_array_equal(read(text), [[1, 2], [3, 4]])
    np.testing.assert_array_equal(read(text, strict=True), [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("text", "line", "got"),
    [
        ("1,2\n3\n3,4", 2, "'3'"),
        ("1,2\n1,2,3\n3,4", 2, "'1,2,3'"),
        ("1,2\n1,b\n3,4", 2, "'1,b'"),
        ("x,y\n1,2\nx,y\n3,4", 3, "'x,y'"),
        ("1,2\n1_0,2\n3,4", 2, "'1_0,2'"),
        (b"1,2\n\xa01,2\n3,4", 2, "'\N{REPLACEMENT CHARACTER}1,2'"),
        (b"1,2\n\x1c1,2\n3,4", 2, "'\\x1c1,2'"),
        ("x,y\n1,2\n" + "9" * 400 + "\n3,4", 3, "9..."),
    ],
)
def test_bad_row_becomes_nan_or_an_error(text, line, got, capsys):
    np.testing.assert_array_equal(read(text), [[1, 2], [np.nan, np.nan], [3, 4]])
    said = capsys.readouterr().err
    assert said.startswith(f"Warning: p, line {line}: expected 2 comma-separated numbers, got ") and got in said
    assert said.endswith("; the answer is nan.\n") and said.count("\n") == 1 and len(said) < 250
    with pytest.raises(ValueError, match=f"p, line {line}: expected 2 comma-separated numbers"):
        read(text, strict=True)


@pytest.mark.parametrize("first", ["0.5;0.5", "1,b", "1 2", "nan;nan"])
def test_bad_first_row_is_no_header(first, capsys):
    np.testing.assert_array_equal(read(first + "\n1,2\n"), [[np.nan, np.nan], [1, 2]])
    assert "p, line 1" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["nan,1\n1,2", "NaN,1\n1,2", "inf,-inf\n1,2"])
def test_nonfinite_numbers_are_points(text, capsys):
    x = read(text, strict=True)
    assert len(x) == 2 and not np.isfinite(x[0]).all()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("data", "message"),
    [
        *((text, "p has no points: expected 2 comma-separated numbers") for text in ("", "\n\n", "x,y\n", " \r\n")),
        (b"\xff\xfe1\x00,\x002\x00", "p must be a text file"),
        (b"\x00\x01\n1,2\n", "p must be a text file"),
        ("1,2\n" + "1" * 250, "p, line 2: expected at most 100 bytes"),
    ],
)
def test_files_without_points_are_refused(data, message, monkeypatch):
    monkeypatch.setattr(table_rows, "_MOST_LINE_BYTES", 100)
    with pytest.raises(ValueError, match=message):
        read(data)


def test_warnings_of_many_bad_rows_are_limited(capsys):
    read("x\n" * 2 + "1,2\n" + "0\n" * 100)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 12 and lines[-1] == "Warning: p has 101 rows that are not points."


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


def test_tables_are_files_or_standard_input(tmp_path, monkeypatch):
    (tmp_path / "a.csv").write_bytes(b"1,2\n")
    name, file = open_table(str(tmp_path / "a.csv"))
    with file:
        assert (name, file.read()) == (str(tmp_path / "a.csv"), b"1,2\n")
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"3,4\n")))
    name, file = open_table("-")
    assert (name, file.read()) == ("stdin", b"3,4\n")
    monkeypatch.setattr("sys.stdin", None)
    with pytest.raises(ValueError, match="Standard input is closed"):
        open_table("-")
