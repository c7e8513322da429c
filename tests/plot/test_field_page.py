"""Pages of distance functions in a browser, where there is one; ``test_page.py`` tests their text."""

import re
from base64 import b64encode

import numpy as np
import pytest
from building_scenes import two_floors
from hostile_files import hostile
from hostile_readers import READERS, Reader
from pair_helpers import serpentine
from PIL import Image
from shapely import Point

from experiments._browser import IS_DRAWN, Browser, axe_core, chromium
from plr_jax import PairPLR, VisibilityGraph, construct, construct_pairs, plot, scenes

pytestmark = pytest.mark.full

PROBLEM = scenes.maze()
WORKSPACE, GOAL = PROBLEM.workspace, PROBLEM.goals[0]


@pytest.fixture(scope="module")
def functions():
    oracle, bounds = VisibilityGraph(WORKSPACE, GOAL), WORKSPACE.bounds
    return {
        "cones": construct(oracle, bounds, leaf="cone", max_bytes=1024, certified=True),
        "planes": construct(oracle, bounds, leaf="plane", max_bytes=2048, certified=True),
        "pairs": construct_pairs(WORKSPACE, max_bytes=600),
    }


def page_of(function):
    return plot.page(function, None if isinstance(function, PairPLR) else WORKSPACE)


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


def shown_distance(browser):
    """The distance that a page displays."""
    (distance,) = re.findall(r": ([\d.]+) workspace units", browser.run('byId("readout").textContent'))
    return float(distance)


def numbers(browser, script):
    """The numbers in the list that a script returns; some may be infinite."""
    texts = browser.run(f"({script}).flat().map(String)")
    return np.array([float(text.replace("Infinity", "inf")) for text in texts])


@pytest.mark.parametrize("name", ["cones", "planes", "pairs"])
def test_page_answers_exactly_like_numpy(name, functions, browser, tmp_path):
    opened(browser, page_of(functions[name]), tmp_path)
    x, y = np.random.default_rng(0).uniform(-0.02, 1.02, (2, 5_000, 2))
    browser.run(f"globalThis.x = {x.tolist()}, globalThis.y = {y.tolist()}; 0")
    reader, ends = functions[name].numpy(), (x, y) if name == "pairs" else (x,)
    distances = numbers(browser, "x.map((each, i) => shown().distance(each, y[i]))")
    np.testing.assert_array_equal(distances, reader(*ends).astype(np.float64))
    bounds = numbers(browser, "x.map((each, i) => shown().bounds(each, y[i]))").reshape(-1, 2)
    np.testing.assert_array_equal(bounds.T, reader.bounds(*ends))


@pytest.mark.parametrize("name", ["cones", "pairs", "planes"])
def test_paths_lead_to_goal_with_shown_length(name, functions, browser, tmp_path):
    opened(browser, page_of(functions[name]), tmp_path)
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


def test_page_of_a_building_shows_one_floor(browser, tmp_path):
    building = two_floors()
    plr = building.oracle(0, (10, 1)).construct(max_bytes=1500, certified=True)
    opened(browser, plot.page(plr, building.plane), tmp_path)
    assert browser.run('byId("title").textContent') == "A building"
    assert browser.run('byId("facts").textContent').startswith(f"{plr.num_bytes:,} bytes; ")
    for floor, x in ((1, (6.0, 11.0)), (0, (3.0, 8.0))):
        browser.run(f'byId("floor").selectedIndex = {floor}, byId("floor").dispatchEvent(new Event("change")), 0')
        place = (np.array(x) + plr.floors.shift[floor]).tolist()
        browser.run(f'move("start", {place}), byId("celled").click(), 0')
        says = browser.run('byId("readout").textContent')
        assert f"From ({x[0]:g}, {x[1]:g}) to the goal" in says
        assert shown_distance(browser) == pytest.approx(float(plr(floor, x)), rel=1e-3)
        assert ("It takes link 2, to floor 0" in says) == (floor == 1)
        assert 0 < browser.run('byId("cells").getAttribute("d").split("M").length - 1') < plr.plane.num_leaves


def test_readout_follows_pointer_and_keys(functions, browser, tmp_path):
    opened(browser, page_of(functions["cones"]), tmp_path)
    box = stage_of(browser)

    def at(x, y):
        return box[0] + x * box[2], box[1] + (1 - y) * box[3]

    browser.mouse("mouseMoved", *at(0.5, 0.6))
    said = browser.run('byId("readout").textContent')
    assert shown_distance(browser) == pytest.approx(float(functions["cones"]([0.5, 0.6])), abs=2e-3)
    assert "Proven to be between" in said
    assert re.search(r"The stored path has \d segments", said)
    browser.mouse("mouseMoved", *at(0.3, 0.7))
    assert "inside a wall" in browser.run('byId("readout").textContent')
    browser.run("stage.focus()")
    before = numbers(browser, "start")
    browser.key("ArrowRight")
    np.testing.assert_allclose(numbers(browser, "start"), before + np.array([0.02, 0]))
    browser.run('byId("celled").click()')
    assert browser.run('byId("cells").getAttribute("d").split("M").length - 1') == functions["cones"].num_leaves


def test_click_starts_swarm_that_arrives(functions, browser, tmp_path):
    browser.prefer(prefers_reduced_motion="no-preference")
    for name in ("cones", "pairs"):
        opened(browser, page_of(functions[name]), tmp_path)
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


@pytest.mark.parametrize("problem", [PROBLEM, scenes.four_rooms(4)])
def test_ends_of_pairs_are_free_and_apart_at_first(problem, browser, tmp_path):
    workspace = problem.workspace
    opened(browser, plot.page(construct_pairs(workspace, max_bytes=2000)), tmp_path)
    ends = numbers(browser, "[start, goal]").reshape(2, 2)
    width, boundary = workspace.bounds.width.max(), workspace.free_space.boundary
    assert workspace.is_free(ends).all() and min(boundary.distance(Point(end)) for end in ends) > 0.03 * width
    assert np.linalg.norm(ends[0] - ends[1]) > 0.8 * width
    assert shown_distance(browser) <= float(browser.run('byId("ticks").firstChild.textContent'))


def test_both_ends_of_pairs_can_be_dragged(functions, browser, tmp_path):
    opened(browser, page_of(functions["pairs"]), tmp_path)
    box = stage_of(browser)
    for end, to in (("start", (0.9, 0.6)), ("goal", (0.1, 0.6)), ("start", (1, 0.48)), ("goal", (0, 0))):
        x, y = numbers(browser, end)
        browser.mouse("mousePressed", box[0] + x * box[2], box[1] + (1 - y) * box[3])
        browser.mouse("mouseMoved", box[0] + to[0] * box[2], box[1] + (1 - to[1]) * box[3])
        browser.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        browser.mouse("mouseReleased", box[0] + to[0] * box[2], box[1] + (1 - to[1]) * box[3])
        np.testing.assert_allclose(numbers(browser, end), to, atol=2e-3)
        farthest = float(browser.run('byId("ticks").firstChild.textContent'))  # the end of the scale
        most = browser.run("values.reduce((most, value) => value < Infinity ? Math.max(most, value) : most, 0)")
        assert farthest >= shown_distance(browser) and farthest >= most
    distance = functions["pairs"].numpy()(numbers(browser, "start"), numbers(browser, "goal"))
    assert shown_distance(browser) == pytest.approx(float(distance), rel=1e-3)
    # Pixels that are not beside walls have the values of the reader.
    apart = numbers(
        browser,
        """Array.from({ length: 400 }, (_, k) => { const [i, j] = [(k * 37) % view.columns, (k * 151) % view.rows];
        const at = (di, dj) => [(i + 0.5 + di) / view.columns, 1 - (j + 0.5 + dj) / view.rows];
        const isFree = [[0, 0], [-2, -2], [2, -2], [-2, 2], [2, 2]].every(([a, b]) => !isWall(at(a, b)));
        return isFree ? Math.abs(values[j * view.columns + i] - shown().distance(at(0, 0), goal)) : 0; })""",
    )
    assert apart.max() < 0.02 and np.median(apart) < 1e-6


def test_background_follows_theme(functions, browser, tmp_path):
    backgrounds = []
    for theme in ("light", "dark"):
        browser.prefer(prefers_color_scheme=theme)
        opened(browser, page_of(functions["cones"]), tmp_path)
        browser.picture(tmp_path / "page.png")
        with Image.open(tmp_path / "page.png") as image:
            backgrounds.append(image.convert("L").getpixel((image.width - 20, 2)))
    assert backgrounds[0] > 250 and backgrounds[1] < 40
    browser.prefer(prefers_color_scheme="light")


def test_chosen_file_is_opened(functions, browser, tmp_path):
    opened(browser, page_of(functions["cones"]), tmp_path)
    document = browser.call("DOM.getDocument")["root"]["nodeId"]
    field = browser.call("DOM.querySelector", nodeId=document, selector="#file")["nodeId"]
    for name, says in (("pairs", "corners"), ("cones", "cones"), ("planes", "cones")):
        (tmp_path / f"{name}.plr").write_bytes(functions[name].to_bytes())
        browser.call("DOM.setFileInputFiles", nodeId=field, files=[str(tmp_path / f"{name}.plr")])
        browser.wait(f'opened.title === "{name}.plr" || !byId("error").hidden')
        assert says in browser.run('byId("facts").textContent')
        assert browser.run('byId("error").hidden') == (name != "planes")
    said = "planes.plr cannot be shown: it holds planes, which this page cannot read; use the command plr-jax view"
    assert browser.run('byId("error").textContent').startswith(said)
    assert browser.run("opened.title") == "cones.plr" and not browser.errors


def test_damaged_files_leave_shown_function(functions, browser, tmp_path):
    valid = [functions[name].to_bytes() for name in ("cones", "pairs", "planes")]
    reader = Reader(lambda path: None, ".plr", lambda: valid, READERS["PLR"].repaired)
    opened(browser, page_of(functions["cones"]), tmp_path)
    shown = 0
    files = [b"", b"no PLR", serpentine(8192).to_bytes(), *(hostile(reader, valid, 0, n) for n in range(200))]
    for file in files:
        browser.run(f'take(bytesOf("{b64encode(file).decode()}"), "a.plr")')  # which raises if it hangs
        is_shown, says = browser.run("[byId('error').hidden, byId('error').textContent]")
        shown += is_shown
        assert is_shown or re.fullmatch(r"a\.plr cannot be shown: .{10,}\.", says), says
        assert "undefined" not in says and "TypeError" not in says and "RangeError" not in says, says
        assert browser.run("shown().size > 0 && Number.isFinite(view.scale)")
    assert 0 < shown < len(files) and not browser.errors


def test_accessibility_check_finds_nothing(functions, browser, tmp_path):
    if (axe := axe_core()) is None:
        pytest.skip("accessibility is checked where npm has installed axe-core globally")
    for theme in ("light", "dark"):
        browser.prefer(prefers_color_scheme=theme)
        for name in ("cones", "pairs"):
            opened(browser, page_of(functions[name]), tmp_path)
            browser.run('document.querySelector("details").open = true')
            browser.run(axe + "; 0")
            found = browser.run("axe.run().then(r => r.violations.map(v => v.id + ': ' + v.nodes.map(n => n.html)))")
            assert found == []
    browser.prefer(prefers_color_scheme="light")
