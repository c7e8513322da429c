import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image
from PIL.ImageSequence import Iterator

from plr_jax import DiscRobot, PointRobot, PolygonRobot, Problem, RectangleRobot, Workspace, plot
from plr_jax.metrics import makespan
from plr_jax.plot._paths import ROBOT_COLORS, timeline

ROBOTS = [DiscRobot(0.5), RectangleRobot(1.0, 0.4), PointRobot()]
STARTS = np.array([(1, 1, 0), (1, 3, 3.0), (1, 5, 0)])
GOALS = np.array([(4, 1, 0), (1, 3, -3.0), (1, 5, 0)])
# The disc goes 3 in the first motion; in the second and fourth nothing moves; in the third the rectangle turns
# from heading 3 to -3: by 2 pi - 6, through pi, at a cost of 10 a radian.
TEAM = Problem(Workspace(((0, 0), (10, 6))), ROBOTS, STARTS, GOALS, rotation_weight=10)
MIDDLE = np.array([(4, 1, 0), (1, 3, 3.0), (1, 5, 0)])
PATH = np.array([STARTS, MIDDLE, MIDDLE, GOALS, GOALS])
TURN = 2 * np.pi - 6
NODE = shutil.which("node")


def test_motion_takes_as_long_as_largest_cost():
    motion = timeline(TEAM, PATH)
    np.testing.assert_allclose(motion.times, [0, 3, 3 + 10 * TURN])  # idle steps are skipped
    assert motion.duration == pytest.approx(makespan(TEAM, PATH))
    np.testing.assert_array_equal(motion.configurations[:, :, :2], PATH[[0, 1, 3]][:, :, :2])
    at = motion.at(np.array([-1.0, 0.0, 1.0, 3.0, 3 + 2.5 * TURN, motion.duration, 1e9]))
    np.testing.assert_allclose(at[:, 0, 0], [1, 1, 2, 4, 4, 4, 4])
    # Through pi, and not the long way.
    np.testing.assert_allclose(at[:, 1, 2], 3 + TURN * np.array([0, 0, 0, 0, 0.25, 1, 1]))
    assert (at[:, 2] == STARTS[2]).all()
    back = timeline(TEAM, PATH[::-1]).configurations[:, 1, 2]
    np.testing.assert_allclose(back, [-3, -3 - TURN, -3 - TURN])
    part = motion.between(1.0, 3 + 5 * TURN)  # holds every step in it
    np.testing.assert_allclose(part[:, 0, 0], [2, 4, 4])
    np.testing.assert_allclose(part[:, 1, 2], [3, 3, 3 + TURN / 2])


def test_gif_shows_robots_in_place(tmp_path):
    animation = plot.animate(TEAM, PATH, seconds=1, frames_per_second=10)
    assert animation.num_frames == 11
    for name in ("A.GIF", "B.GIF"):
        animation.save(tmp_path / name)
    assert (tmp_path / "A.GIF").read_bytes() == (tmp_path / "B.GIF").read_bytes()
    with Image.open(tmp_path / "A.GIF") as image:
        assert image.info["loop"] == 0
        frames = [(frame.info["duration"], np.array(frame.convert("RGB"), int)) for frame in Iterator(image)]
    assert [duration for duration, _ in frames[:-1]] == [100] * 10 and frames[-1][0] > 1000
    height, width = frames[0][1].shape[:2]
    panel = 10 / (width - 2 * 0.08 * 120)  # workspace units a pixel, within the margins
    for (_, picture), center in ((frames[0], 1), (frames[10], 4)):
        disc = (np.abs(picture - 255 * np.array(to_rgb(ROBOT_COLORS[0]))) < 2).all(axis=-1)
        disc[:, : int((center - 0.4) / panel)] = False  # the trail
        disc[:, int((center + 0.8) / panel) :] = False  # the outline of the goal
        rows, columns = np.nonzero(disc)
        assert (columns.mean() - 0.08 * 120) * panel == pytest.approx(center, abs=0.1)
        assert (height - 0.08 * 120 - rows.mean()) * panel == pytest.approx(1, abs=0.1)
    first = frames[0][1]
    assert (first[0] == 255).all() and (first[height // 2, width // 2] == 255).all()  # white, not nearly white


def page_of(animation, folder):
    animation.save(folder / "page.html")
    return (folder / "page.html").read_text(encoding="utf-8")


def motion_in(page):
    return json.loads(re.search(r"^const \{.*?\} = (\{.*\});$", page, re.MULTILINE).group(1))


def svg_in(page):
    return ElementTree.fromstring(re.search(r"<svg viewBox.*?</svg>", page, re.DOTALL).group(0))


@pytest.mark.parametrize("scale", [1e-3, 1e6])
def test_poses_are_exact_to_less_than_a_pixel(tmp_path, scale):
    goal = np.array([(0.123456789 * scale, 0.987654321 * scale)])
    box = Workspace(((0, 0), (scale, scale)))
    problem = Problem(box, [PointRobot()], [(0.5 * scale, 0.5 * scale)], goal)
    motion = motion_in(page_of(plot.animate(problem, [problem.starts, goal]), tmp_path))
    np.testing.assert_allclose(motion["steps"][-1], goal, atol=1e-4 * scale)
    assert motion["times"] == [0, 1]


def test_page_is_complete_and_loads_nothing(tmp_path):
    page = page_of(plot.animate(TEAM, PATH), tmp_path)
    assert not re.search(r"https?:|//[a-z]|\bsrc=|\bhref=|@import|url\(|fetch\(|import ", page)
    assert "{{" not in page and "}}" not in page.split("<script>")[0]
    svg = svg_in(page)
    assert [e.get("id") for e in svg.iter("g")] == [f"{kind}{i}" for i in range(3) for kind in ("place", "turn")]
    trails = [e for e in svg.iter("polyline") if e.get("class") == "trail"]
    assert [e.get("stroke") for e in trails] == list(ROBOT_COLORS[:3])
    assert trails[0].get("points").split()[0] == "52.00,260.00"  # (1, 1) at 52 pixels a unit, y downward from 6
    assert [e.text for e in svg.iter("text")] == ["0", "1", "2"]
    beside = [e for e in svg.iter("text") if e.get("class") == "beside"]
    assert [e.text for e in beside] == ["2"] and float(beside[0].get("x")) > 5  # a dot has no room for one


def test_page_follows_theme_and_draws_any_outline(tmp_path):
    """A triangle with its apex ahead, and the disc: black and white are those of the theme."""
    triangle = PolygonRobot([(0.6, 0), (-0.3, 0.5), (-0.3, -0.5)])
    problem = Problem(TEAM.workspace, [triangle, ROBOTS[0]], STARTS[:2], GOALS[:2])
    page = page_of(plot.animate(problem, [problem.starts, problem.goals]), tmp_path)
    assert "@media (prefers-color-scheme: dark)" in page
    svg = svg_in(page)
    drawn = {(e.tag, e.get("class")): e for e in svg.iter()}
    assert drawn["polygon", "body"].get("points") == "31.20,-0.00 -15.60,-26.00 -15.60,26.00"
    front = [tuple(map(float, point.split(","))) for point in drawn["polyline", "front"].get("points").split()]
    assert len(front) == 3  # both sides that meet at the apex
    np.testing.assert_allclose(front[1], (52 * (4 + 0.6), 52 * (6 - 1)), atol=0.01)
    assert drawn["circle", "body"].get("r") == "26.00"
    assert not any(e.get(name) in ("#fff", "white") for e in svg.iter("polygon") for name in ("fill", "stroke"))


def test_notebook_shows_separate_frames(tmp_path):
    animation = plot.animate(TEAM, PATH, seconds=3)
    tags = []
    parser = HTMLParser()
    parser.handle_starttag = lambda tag, attributes: tags.append((tag, dict(attributes)))
    parser.feed(animation._repr_html_())
    ((tag, frame),) = tags  # no script or id outside of the frame
    assert tag == "iframe" and frame["srcdoc"] == page_of(animation, tmp_path)
    assert frame["sandbox"] == "allow-scripts"
    assert int(frame["width"]) > int(frame["height"]) > 300


STAGE = """
const elements = {}, document = { getElementById: id => elements[id] ??= {
  attributes: {}, listeners: {}, setAttribute(k, v) { this.attributes[k] = v; },
  addEventListener(kind, f) { this.listeners[kind] = f; } } };
const matchMedia = () => ({ matches: false });
let next = null;
const requestAnimationFrame = f => { next = f; };
const frame = now => { const f = next; next = null; f(now); };
const report = () => Object.fromEntries(Object.entries(elements).map(([k, e]) => [k, { ...e.attributes }]));
const reports = [];
"""


def played(page, script):
    """Run the page's script on stand-ins of its elements, and return the reports of ``script``."""
    if NODE is None:
        pytest.skip("node is not installed")
    source = STAGE + re.search(r"<script>(.*)</script>", page, re.DOTALL).group(1)
    source += script + "\nconsole.log(JSON.stringify(reports));"
    done = subprocess.run([NODE, "-e", source], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_player_shows_poses_of_timeline(tmp_path):
    animation = plot.animate(TEAM, PATH)
    shares = [0.0, 0.2, 0.51, 0.7, 1.0]
    script = f"for (const share of {shares}) {{ show(share); reports.push(report()); }}"
    reports = played(page_of(animation, tmp_path), script)
    poses = animation.motion.at(np.array(shares) * animation.motion.duration)
    for shown, q in zip(reports, poses, strict=True):
        for i in range(3):
            place = re.fullmatch(r"translate\((.*) (.*)\)", shown[f"place{i}"]["transform"]).groups()
            assert list(map(float, place)) == pytest.approx([52 * q[i, 0], 52 * (6 - q[i, 1])], abs=0.02)
        turn = re.fullmatch(r"rotate\((.*)\)", shown["turn1"]["transform"]).group(1)
        assert float(turn) == pytest.approx(-np.degrees(q[1, 2]), abs=0.02)
        assert "transform" not in shown["turn0"]
        trail = shown["trail0"]["stroke-dasharray"].split()[0]
        assert float(trail) == pytest.approx(52 * (q[0, 0] - 1), abs=0.02)


def test_player_plays_pauses_slides_and_repeats(tmp_path):
    script = """
    const log = () => reports.push(elements.time.value);
    frame(0); log(); frame(1000); log(); frame(4000); log(); frame(5000); log();  // 4 s, and a hold of 1.2 s
    frame(5400); log();
    elements.play.listeners.click(); frame(6000); log();
    elements.time.listeners.input({ target: { value: "0.5" } }); log();
    elements.play.listeners.click(); frame(9000); frame(9400); log();
    """
    reports = played(page_of(plot.animate(TEAM, PATH, seconds=4), tmp_path), script)
    np.testing.assert_allclose(reports, [0, 0.25, 1, 1, 0.05, 0.05, 0.5, 0.6], atol=1e-9)


def test_wrong_arguments_raise():
    for arguments, message in [
        ({"path": PATH[:, 0]}, "A path must have shape"),
        ({"path": PATH[:1]}, "path must move a robot .* got 1 step"),
        ({"path": PATH[[0, 0]]}, "path must move a robot .* got 2 step"),
        ({"path": np.where(PATH == 4, np.inf, PATH)}, "A path must be finite, got .* in step 1"),
        ({"seconds": 0}, "seconds must be a positive finite number"),
        ({"seconds": float("inf")}, "seconds must be a positive finite number"),
        ({"frames_per_second": 0}, "frames_per_second must be above 0 and at most 50"),
        ({"frames_per_second": 60}, "frames_per_second must be above 0 and at most 50"),
    ]:
        with pytest.raises(ValueError, match=message):
            plot.animate(TEAM, **({"path": PATH} | arguments))


def test_other_endings_raise_and_write_nothing(tmp_path):
    for name in ("a.mp4", "a", "gif"):
        with pytest.raises(ValueError, match=r"written to a \.gif or \.html file"):
            plot.animate(TEAM, PATH).save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []
