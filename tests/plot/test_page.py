"""Pages of distance functions as text; ``test_field_page.py`` opens them in a browser."""

import re
import zlib
from base64 import b64decode

import pytest

from plr_jax import Box, Euclidean, VisibilityGraph, Workspace, construct, construct_pairs, plot

ROOM = Workspace(((0, 0), (4, 3)), [[(1, 0), (2, 0), (2, 2), (1, 2)]])


@pytest.fixture(scope="module")
def cones():
    return construct(VisibilityGraph(ROOM, (3, 1)), ROOM.bounds, leaf="cone", max_leaves=8).with_label("a </script>")


def script_of(page):
    """The script that is packed into a page."""
    (data,) = re.findall(r'atob\("([^"]*)"\)', page.html)
    return zlib.decompress(b64decode(data), wbits=-15).decode()


def test_page_is_complete_and_loads_nothing(cones):
    functions = {
        "cones": cones,
        "planes": construct(Euclidean((3, 1)), ROOM.bounds, max_leaves=4),
        "one leaf": construct(Euclidean((3, 1)), ROOM.bounds, max_leaves=1),
        "pairs": construct_pairs(ROOM, max_bytes=400),
    }
    for name, function in functions.items():
        page = plot.page(function, None if name == "pairs" else ROOM)
        for text in (re.sub(r'atob\("[^"]*"\)', "", page.html), script_of(page)):
            loads = re.search(r"https?:|\bsrc=|\bhref=|@import|url\(|fetch\(|^import |XMLHttp|WebSocket", text)
            assert not loads and "{{" not in text, name
        assert "default-src 'none'" in page.html and len(page.html) < 60_000


def test_title_is_escaped_label(cones):
    assert "<title>a &lt;/script&gt;</title>" in plot.page(cones, ROOM).html
    assert "<title>{{script}}</title>" in plot.page(cones.with_label("{{script}}"), ROOM).html


def test_page_is_saved_and_shown_in_notebook(cones, tmp_path):
    page = plot.page(cones, ROOM)
    page.save(tmp_path / "a.html")
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == page.html
    assert page._repr_html_().startswith("<iframe srcdoc=") and 'sandbox="allow-scripts"' in page._repr_html_()
    with pytest.raises(ValueError, match=r"written to an \.html file"):
        page.save(tmp_path / "a.png")


def test_other_functions_raise(cones):
    with pytest.raises(ValueError, match="needs a PLR or a PairPLR"):
        plot.page(cones.numpy())
    with pytest.raises(ValueError, match="got one of 3"):
        plot.page(construct(Euclidean((0, 0, 0)), Box((-1, -1, -1), (1, 1, 1)), max_leaves=1))
