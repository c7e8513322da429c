"""Pages of distance functions: what they hold, and what they do in a real browser, where there is one."""

import re
import zlib
from base64 import b64decode, b64encode

import numpy as np
import pytest
from hostile_files import hostile
from hostile_readers import READERS, Reader, corridor
from PIL import Image

from experiments._browser import IS_DRAWN, Browser, axe_core, chromium
from plr_jax import Euclidean, PairPLR, VisibilityGraph, construct, construct_pairs, plot, scenes

pytestmark = pytest.mark.full

PROBLEM = scenes.maze()
WORKSPACE, GOAL = PROBLEM.workspace, PROBLEM.goals[0]


@pytest.fixture(scope="module")
def held():
    """What pages show: PLRs of cones, of planes, and pairs."""
    oracle = VisibilityGraph(WORKSPACE, GOAL)

    def plr(leaf, max_bytes):
        return construct(oracle, WORKSPACE.bounds, leaf=leaf, max_bytes=max_bytes, certified=True)

    cones = plr("cone", 1024).with_label("maze </script>")
    return {
        "cones": cones,
        "planes": plr("plane", 2048),
        "smooth": plr("smooth", 400),
        "one leaf": construct(oracle, WORKSPACE.bounds, max_leaves=1),
        "pairs": construct_pairs(WORKSPACE, max_bytes=600),
    }


def page_of(held):
    return plot.page(held, None if isinstance(held, PairPLR) else WORKSPACE)


def script_of(page):
    """The script that is packed into a page."""
    (data,) = re.findall(r'atob\("([^"]*)"\)', page.html)
    return zlib.decompress(b64decode(data), wbits=-15).decode()


def test_a_page_loads_nothing_is_small_and_has_no_gaps(held):
    for name, each in held.items():
        page = page_of(each)
        for text in (re.sub(r'atob\("[^"]*"\)', "", page.html), script_of(page)):
            assert not re.search(r"https?:|\bsrc=|\bhref=|@import|url\(|fetch\(|^import |XMLHttp|WebSocket", text), (
                name
            )
            assert "{{" not in text
        assert "default-src 'none'" in page.html and len(page.html) < 60_000 and "Page(" in repr(page)
    assert "<title>maze &lt;/script&gt;</title>" in page_of(held["cones"]).html
    assert page_of(held["cones"]).html == page_of(held["cones"]).html
    assert "<title>{{script}}</title>" in page_of(held["cones"].with_label("{{script}}")).html


def test_a_page_is_saved_and_shows_itself_in_a_notebook(held, tmp_path):
    page = page_of(held["cones"])
    page.save(tmp_path / "a.html")
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == page.html
    assert page._repr_html_().startswith("<iframe srcdoc=") and 'sandbox="allow-scripts"' in page._repr_html_()
    with pytest.raises(ValueError, match=r"written to an \.html file"):
        page.save(tmp_path / "a.png")


def test_what_is_not_shown_is_refused(held):
    with pytest.raises(ValueError, match="needs a PLR or a PairPLR"):
        plot.page(held["cones"].numpy())
    with pytest.raises(ValueError, match="got one of 3"):
        plot.page(construct(Euclidean((0, 0, 0)), ((-1, -1, -1), (1, 1, 1)), max_leaves=4))


@pytest.fixture(scope="module")
def browser():
    if chromium() is None:
        pytest.skip("pages are tried in Chromium where there is one")
    with Browser() as browser:
        yield browser


def opened(browser, page, folder):
    page.save(folder / "page.html")
    browser.open(folder / "page.html", IS_DRAWN)
    assert browser.run('byId("error").hidden') and not browser.errors
    assert browser.requests == [(folder / "page.html").resolve().as_uri()]
    return browser


def stage_of(browser):
    """The left and upper edge of the picture, its width and height."""
    return browser.run("(r => [r.left, r.top, r.width, r.height])(stage.getBoundingClientRect())")


def told_in(said):
    """The distance in what a page says."""
    (told,) = re.findall(r": ([\d.]+) workspace units", said)
    return float(told)


def numbers(browser, script):
    """What an expression gives that is a list of numbers, some of them not finite."""
    texts = browser.run(f"({script}).flat().map(String)")
    return np.array([float(text.replace("Infinity", "inf")) for text in texts])


@pytest.mark.parametrize("name", ["cones", "planes", "smooth", "one leaf", "pairs"])
def test_answers_are_those_of_numpy_at_ten_thousand_points(name, held, browser, tmp_path):
    each = held[name]
    opened(browser, page_of(each), tmp_path)
    x = np.random.default_rng(0).uniform(-0.02, 1.02, (20_000 if name == "pairs" else 10_000, 2))
    browser.run(f"globalThis.x = {x.tolist()}; 0")
    if name == "pairs":
        x, y = x[::2], x[1::2]
        found = numbers(browser, "x.map((_, i) => i % 2 ? [] : shown().distance(x[i], x[i + 1]))")
        expected = each.numpy()(x, y)
        bounds = numbers(browser, "x.map((_, i) => i % 2 || i > 2000 ? [] : shown().bounds(x[i], x[i + 1]))")
        np.testing.assert_array_equal(bounds.reshape(-1, 2).T, each.numpy().bounds(x[:1001], y[:1001]))
    else:
        found, expected = numbers(browser, "x.map(shown().distance)"), each.numpy()(x)
        if each.max_error is not None:
            bounds = numbers(browser, "x.map(shown().bounds)").reshape(-1, 2)
            np.testing.assert_array_equal(bounds.T, each.numpy().bounds(x))
    np.testing.assert_array_equal(found, expected.astype(np.float64))


@pytest.mark.parametrize("name", ["cones", "pairs", "planes"])
def test_paths_lead_to_the_goal_and_are_as_long_as_is_told(name, held, browser, tmp_path):
    opened(browser, page_of(held[name]), tmp_path)
    browser.run("goal = [0.06, 0.07]")
    arrived = 0
    for x in WORKSPACE.sample_free(20, seed=1).tolist():
        path = numbers(browser, f"shown().route({x}{', goal' if name == 'pairs' else ''})").reshape(-1, 2)
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        exact = VisibilityGraph(WORKSPACE, (0.06, 0.07))(np.array([x]))[0]
        arrived += np.linalg.norm(path[-1] - GOAL) < 0.02
        slack = 0.05 if name == "planes" else 1e-3
        assert length < exact * (1 + slack) + slack
    assert arrived == 20 if name != "planes" else arrived >= 12  # the slope of planes leads into some walls


def test_what_is_told_follows_the_pointer_and_keys(held, browser, tmp_path):
    opened(browser, page_of(held["cones"]), tmp_path)
    box = stage_of(browser)

    def at(x, y):
        return box[0] + x * box[2], box[1] + (1 - y) * box[3]

    browser.mouse("mouseMoved", *at(0.5, 0.6))
    said = browser.run('byId("readout").textContent')
    assert (
        told_in(said) == pytest.approx(float(held["cones"]([0.5, 0.6])), abs=2e-3) and "Proven to be between" in said
    )
    assert re.search(r"The stored path has \d segments", said)
    browser.mouse("mouseMoved", *at(0.3, 0.7))
    assert "inside a wall" in browser.run('byId("readout").textContent')
    browser.run("stage.focus()")
    before = numbers(browser, "start")
    browser.key("ArrowRight")
    np.testing.assert_allclose(numbers(browser, "start"), before + np.array([0.02, 0]))
    browser.run('byId("celled").click()')
    assert browser.run('byId("cells").getAttribute("d").split("M").length - 1') == held["cones"].num_leaves


def test_a_click_starts_a_swarm_that_arrives(held, browser, tmp_path):
    browser.prefer(prefers_reduced_motion="no-preference")
    for name in ("cones", "pairs"):
        opened(browser, page_of(held[name]), tmp_path)
        x, y = browser.run("(r => [r.left + 0.6 * r.width, r.top + 0.1 * r.height])(stage.getBoundingClientRect())")
        browser.mouse("mousePressed", x, y)
        browser.mouse("mouseReleased", x, y)
        assert browser.run("playing && swarm.length") == 80
        browser.run("advance(1)")
        assert browser.run("swarm.every(one => one.way > 0.2)")
        browser.run("advance(100)")
        places = numbers(browser, "swarm.map(placeOf)").reshape(-1, 2)
        np.testing.assert_allclose(places, np.tile(numbers(browser, "goal"), (80, 1)), atol=1e-6)
        assert not browser.run("playing")


def test_either_end_of_pairs_is_dragged(held, browser, tmp_path):
    opened(browser, page_of(held["pairs"]), tmp_path)
    box = stage_of(browser)
    for end, to in (("start", (0.9, 0.6)), ("goal", (0.1, 0.6))):
        x, y = numbers(browser, end)
        browser.mouse("mousePressed", box[0] + x * box[2], box[1] + (1 - y) * box[3])
        browser.mouse("mouseMoved", box[0] + to[0] * box[2], box[1] + (1 - to[1]) * box[3])
        browser.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        browser.mouse("mouseReleased", box[0] + to[0] * box[2], box[1] + (1 - to[1]) * box[3])
        np.testing.assert_allclose(numbers(browser, end), to, atol=2e-3)
    ends = numbers(browser, "start"), numbers(browser, "goal")
    assert told_in(browser.run('byId("readout").textContent')) == pytest.approx(
        float(held["pairs"].numpy()(*ends)), rel=1e-3
    )
    # The picture: values of pixels that are not beside walls are those of the reader.
    apart = numbers(
        browser,
        """Array.from({ length: 400 }, (_, k) => { const [i, j] = [(k * 37) % view.columns, (k * 151) % view.rows];
        const at = (di, dj) => [(i + 0.5 + di) / view.columns, 1 - (j + 0.5 + dj) / view.rows];
        const isFree = [[0, 0], [-2, -2], [2, -2], [-2, 2], [2, 2]].every(([a, b]) => !isWall(at(a, b)));
        return isFree ? Math.abs(values[j * view.columns + i] - shown().distance(at(0, 0), goal)) : 0; })""",
    )
    assert apart.max() < 0.02 and np.median(apart) < 1e-6


def test_pictures_are_those_of_the_theme_and_have_the_colors_of_distances(held, browser, tmp_path):
    page = page_of(held["cones"])
    backgrounds = []
    for theme in ("light", "dark"):
        browser.prefer(prefers_color_scheme=theme)
        opened(browser, page, tmp_path)
        browser.picture(tmp_path / f"{theme}.png")
        with Image.open(tmp_path / f"{theme}.png") as image:
            pixels = np.asarray(image.convert("RGB")).astype(int)
        backgrounds.append(pixels[2, -20].mean())
        frame = stage_of(browser)

        def color(x, y, pixels=pixels, frame=frame):
            return pixels[int(frame[1] + (1 - y) * frame[3]), int(frame[0] + x * frame[2])]

        near, far = color(0.12, 0.12), color(0.05, 0.98)
        assert near[2] > near[1] and far[0] > 150 and far[1] > 150 and far[2] < 120  # violet, and yellow
        assert np.ptp(color(0.5, 0.45)) <= 2  # a wall
    assert backgrounds[0] > 250 and backgrounds[1] < 40
    browser.prefer(prefers_color_scheme="light")


def test_another_file_is_opened_where_one_is_given(held, browser, tmp_path):
    opened(browser, page_of(held["cones"]), tmp_path)
    document = browser.call("DOM.getDocument")["root"]["nodeId"]
    field = browser.call("DOM.querySelector", nodeId=document, selector="#file")["nodeId"]
    for name, says in (("pairs", "corners"), ("cones", "cones"), ("planes", "cones")):
        (tmp_path / f"{name}.plr").write_bytes(held[name].to_bytes())
        browser.call("DOM.setFileInputFiles", nodeId=field, files=[str(tmp_path / f"{name}.plr")])
        browser.wait(f'opened.title === "{name}.plr" || !byId("error").hidden')
        assert says in browser.run('byId("facts").textContent')
        assert browser.run('byId("error").hidden') == (name != "planes")
    said = "planes.plr cannot be shown: it holds planes, which this page cannot read; use the command plr-jax view"
    assert browser.run('byId("error").textContent').startswith(said)
    assert browser.run("opened.title") == "cones.plr" and not browser.errors


def test_damaged_files_are_refused_in_words_and_what_was_shown_stays(held, browser, tmp_path):
    valid = [held[name].to_bytes() for name in ("cones", "pairs", "planes")]
    reader = Reader(lambda path: None, ".plr", lambda: valid, READERS["PLR"].repaired)
    opened(browser, page_of(held["cones"]), tmp_path)
    shown = 0
    files = [b"", b"no PLR", corridor(8192), *(hostile(reader, valid, 0, number) for number in range(200))]
    for file in files:
        browser.run(f'take(bytesOf("{b64encode(file).decode()}"), "a.plr")')  # which raises if it hangs
        is_shown, says = browser.run("[byId('error').hidden, byId('error').textContent]")
        shown += is_shown
        assert is_shown or re.fullmatch(r"a\.plr cannot be shown: .{10,}\.", says), says
        assert "undefined" not in says and "TypeError" not in says and "RangeError" not in says, says
        assert browser.run("shown().size > 0 && Number.isFinite(view.scale)")
    assert 0 < shown < len(files) and not browser.errors


def test_an_accessibility_check_finds_nothing(held, browser, tmp_path):
    if (axe := axe_core()) is None:
        pytest.skip("accessibility is checked where npm has installed axe-core globally")
    for theme in ("light", "dark"):
        browser.prefer(prefers_color_scheme=theme)
        for name in ("cones", "pairs"):
            opened(browser, page_of(held[name]), tmp_path)
            browser.run('document.querySelector("details").open = true')
            browser.run(axe + "; 0")
            found = browser.run("axe.run().then(r => r.violations.map(v => v.id + ': ' + v.nodes.map(n => n.html)))")
            assert found == []
    browser.prefer(prefers_color_scheme="light")
