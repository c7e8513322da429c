"""The site: every public name is on it, its links resolve, its search finds names, and pages open offline."""

import json
import os
import re
import shlex
import subprocess
import sys
from html.parser import HTMLParser
from inspect import getdoc, isclass, ismodule
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from page_helpers import blocks

import plr_jax
from experiments._browser import Browser, chromium

ROOT = Path(__file__).parent.parent
PAGES = [
    "index.html",
    "plr_jax/guides/distance_function.html",
    "api/plrs.html",
    "notebooks/index.html",
    "notebooks/3_a_team.html",  # with pages of `plr_jax.plot` inside
]
pytestmark = pytest.mark.full
in_chromium = pytest.mark.skipif(chromium() is None, reason="needs Chromium")


class Parsed(HTMLParser):
    """A page's anchors, links, and the addresses of what it loads."""

    def __init__(self, text):
        super().__init__()
        self.anchors, self.links, self.loads = set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.anchors.add(attributes.get("id"))
        self.links += [attributes["href"]] if tag == "a" and "href" in attributes else []
        self.loads += [attributes[name] for name in ("src", "href") if tag != "a" and name in attributes]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Run the README's command for the site, which takes some seconds."""
    folder = tmp_path_factory.mktemp("site")
    text = (ROOT / "README.md").read_text()
    (command,) = (line for block in blocks(text, "sh") for line in block.splitlines() if line.startswith("mkdocs "))
    words = [sys.executable, "-m", *shlex.split(command), "--site-dir", str(folder)]
    assert "--strict" in words  # warnings, as of missing names, fail
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def parsed(site):
    return {path: Parsed(path.read_text()) for path in site.rglob("*.html")}


def public_modules():
    return [plr_jax] + [value for name in plr_jax.__all__ if ismodule(value := getattr(plr_jax, name))]


def test_every_public_name_has_a_section_with_its_docstring(site):
    text = "".join(path.read_text() for path in (site / "api").glob("*.html"))
    shortest = {}  # what is public in two modules has one section
    for module in public_modules():
        for name in module.__all__:
            public = getattr(module, name)
            dotted = f"{module.__name__}.{name}"
            if module is plr_jax.guides:
                assert f' id="{dotted}"' in (site / "plr_jax" / "guides" / f"{name}.html").read_text()
            elif public is not plr_jax.guides:
                dotted = shortest.setdefault(id(public), dotted)
                _, found, section = text.partition(f' id="{dotted}"')
                assert found, dotted
                if name != "DistanceFn":  # an alias of a type
                    begin = re.split("[:`'\"<&]", getdoc(public))[0].split("\n")[0].strip()
                    assert begin and begin in re.sub("<[^>]+>", "", section.partition("doc-contents")[2][:1000]), (
                        dotted
                    )
                if isclass(public) and any("__call__" in vars(base) for base in public.__mro__):
                    assert f' id="{dotted}.__call__"' in text, dotted


def test_results_have_one_bullet_and_functions_come_before_classes(site):
    """By default, mkdocstrings makes a bullet of each line of *Returns*."""
    num_lists = 0
    for path in (site / "api").glob("*.html"):
        for section in path.read_text().split("Returns:</span>")[1:]:
            num_lists += 1
            assert section.partition("</ul>")[0].count('<li class="doc-section-item') == 1, path
    assert num_lists > 5
    text = (site / "api" / "plrs.html").read_text()
    order = [
        text.index(f' id="plr_jax.{name}"') for name in ("construct", "evaluate", "PLR", "PLR.bounds", "PLR.dim")
    ]
    assert order == sorted(order) and "file_bytes" not in text


def test_all_links_and_anchors_resolve(site, parsed):
    num_anchors = 0
    for path, page in parsed.items():
        for link in page.links:
            address = urlsplit(link)
            if address.scheme in ("http", "https"):
                continue
            target = (path.parent / unquote(address.path)).resolve() if address.path else path
            assert target.is_file() and target.is_relative_to(site), (path, link)
            if address.fragment and target.suffix == ".html":
                num_anchors += 1
                assert unquote(address.fragment) in parsed[target].anchors, (path, link)
    assert num_anchors > 1000


def test_pages_load_nothing_from_outside(parsed):
    for path, page in parsed.items():
        assert [load for load in page.loads if urlsplit(load).scheme not in ("", "data")] == [], path


def test_search_index_holds_all_pages(site, parsed):
    index = json.loads((site / "search" / "search_index.json").read_text())["docs"]
    assert {entry["location"].partition("#")[0] or "index.html" for entry in index} >= {
        path.relative_to(site).as_posix() for path in parsed
    }
    assert any("cost_distance" in entry["title"] for entry in index)


@in_chromium
@pytest.mark.parametrize("width", [1280, 420])
def test_pages_show_in_light_and_dark_without_errors_or_requests(site, width):
    shades = {}
    for scheme in ("light", "dark"):
        with Browser(width, 900) as browser:
            browser.prefer(prefers_color_scheme=scheme)
            for page in PAGES:
                browser.open(site / page)
                assert browser.run("document.querySelector('h1') !== null && document.fonts.status === 'loaded'")
                assert browser.run("document.documentElement.scrollWidth <= innerWidth"), page
                shades[scheme] = browser.run("getComputedStyle(document.body).backgroundColor")
                assert browser.errors == [], page
                assert all(urlsplit(address).scheme in ("file", "data", "blob") for address in browser.requests)
    assert shades["light"] == "rgb(255, 255, 255)" != shades["dark"]


@in_chromium
def test_no_code_of_a_guide_is_cut_off(site):
    fits = "[...document.querySelectorAll('pre > code')].every(code => code.scrollWidth <= code.clientWidth)"
    with Browser(1280, 900) as browser:
        for page in (site / "plr_jax" / "guides").glob("*.html"):
            browser.open(page)
            assert browser.run(fits), page


@in_chromium
@pytest.mark.parametrize(
    ("text", "page"),
    [("cost_distance", "api/cost_distance"), ("release", "CHANGELOG"), ("gallery", "notebooks/index")],
)
def test_typed_search_shows_a_result(site, text, page):
    with Browser(1280, 900) as browser:
        browser.open(site / "index.html")
        browser.run("document.querySelector('.md-search__input').focus()")
        browser.call("Input.insertText", text=text)
        browser.key("Shift")  # the box reads its text when a key is let go
        browser.wait("document.querySelector('.md-search-result__item a') !== null")
        address = urlsplit(browser.run("document.querySelector('.md-search-result__item a').href"))
        assert Path(unquote(address.path)) == site / f"{page}.html"
        assert browser.errors == []
