"""Make self-contained web pages: interactive pages of distance functions, and parts of the pages of animations."""

import html
import json
import re
import zlib
from base64 import b64encode
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float

from plr_jax._arrays import require_type, shortened
from plr_jax._files import StrPath, file_path, write_atomically
from plr_jax.buildings import BuildingPLR
from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace
from plr_jax.pairs import PairPLR
from plr_jax.pairs.portable import js_pairs_reader
from plr_jax.plot import _axes, _plane
from plr_jax.plr import PLR, NumpyPLR
from plr_jax.plr.leaves import Cone
from plr_jax.plr.portable.javascript import js_cone_reader, js_file_reader

_FRAME = (560, 900)  # width and height, in pixels, of a page in a notebook
_EXPORTED = re.compile(r"^export function (\w+)", re.MULTILINE)  # names that a JavaScript module exports
SIZE = 520.0  # pixels of the longer side of the bounds, before the browser scales the picture
BORDER = 2.0  # pixels of margin around the bounds
PLAY = '<button id="play" aria-label="Play or pause"><svg viewBox="0 0 14 14"><path id="icon"/></svg></button>'
"""The play button that ``clock.js`` controls."""


def asset(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def html_document(title: str, style: str, body: str, script: str) -> str:
    """Assemble a web page: ``style`` is CSS added to ``page.css``, ``body`` is HTML, and ``script`` is JavaScript."""
    style = asset("page.css").replace("{{ink}}", _axes.INK).replace("{{obstacle}}", _plane.OBSTACLE) + style
    # The title is last, because it may contain a placeholder.
    placeholders = {"style": style, "body": body, "script": script, "title": html.escape(title)}
    page = asset("page.html")
    for name, value in placeholders.items():
        page = page.replace("{{" + name + "}}", value)
    return page


def packed_script(script: str) -> str:
    """Return a short script that holds ``script`` compressed (deflate, base 64), and unpacks and runs it."""
    lines = (line.strip() for line in script.splitlines())
    bare = "\n".join(line for line in lines if line and not line.startswith("//"))
    data = b64encode(zlib.compress(bare.encode(), 9, wbits=-15)).decode()  # no header, as "deflate-raw" expects
    return asset("unpack.js").replace("{{data}}", data)


def in_iframe(page: str, width: float | int, height: float | int) -> str:
    attributes = f'width="{width:.0f}" height="{height:.0f}" sandbox="allow-scripts" style="border:0;max-width:100%"'
    return f'<iframe srcdoc="{html.escape(page)}" {attributes}></iframe>'


def pixel_scale(bounds: Box) -> float:
    return SIZE / float(bounds.width.max())


def pixels(bounds: Box, points: Float[np.ndarray, "n 2"]) -> str:
    """Return points as text for SVG, as pixel coordinates from the upper left corner of the bounds."""
    scale = pixel_scale(bounds)
    x, y = scale * (points[:, 0] - bounds.lo[0]), scale * (bounds.hi[1] - points[:, 1])
    return " ".join(f"{a:.2f},{b:.2f}" for a, b in zip(x, y, strict=True))


def obstacles_path(workspace: Workspace, bounds: Box) -> str:
    """Return a workspace's obstacles as SVG path data, in pixels (:func:`pixels`), for the even-odd fill rule."""
    rings = shapely.get_rings(_plane.blocked_polygons(workspace))
    return "".join(f"M{pixels(bounds, shapely.get_coordinates(ring)[:-1])}Z" for ring in rings)


@dataclass(frozen=True, eq=False)
class Page:
    """A web page that shows a distance function, made by :func:`page`. Notebooks show it; ``html`` is its text."""

    html: str

    def save(self, path: StrPath) -> None:
        """Write the page to an ``.html`` file; another ending of the name raises ``ValueError``."""
        if (path := file_path(path)).suffix.lower() != ".html":
            raise ValueError(f"A page must be written to an .html file, got {str(path)!r}.")
        write_atomically(path, self.html.encode())

    def __repr__(self) -> str:
        return f"Page({len(self.html.encode()):,} bytes)"

    def _repr_html_(self) -> str:
        return in_iframe(self.html, *_FRAME)


def page(plr_or_pairs: PLR | BuildingPLR | PairPLR, workspace: Workspace | None = None) -> Page:
    """Return a self-contained web page of a distance function, which needs no server or network.

    The page shows distances as colors and contours, the walls, and optionally the cells. At the pointer it shows the
    distance, its proven bounds and a path. A click starts a swarm of points that flow to the goal. For pairs
    (distances between any two points), both points can be dragged. Other files of pairs, or of PLRs with cone leaves,
    can be dropped on the page. Of a building, the page shows one floor at a time. Distances equal those of
    ``plr.numpy()`` and ``pairs.numpy()``, bit for bit.

    For a PLR, the walls drawn are the obstacles of ``workspace``, or of ``building.plane``; pairs have walls of their
    own. ``ValueError`` is raised unless the first argument is a PLR, BuildingPLR or PairPLR in the plane, and
    ``workspace`` is a Workspace or None.
    """
    source, floors, links = plr_or_pairs, None, []
    if isinstance(source, BuildingPLR):
        source, of_building, shift = source.plane, source.floors, source.floors.shift
        parts = zip((of_building.lo + shift).tolist(), (of_building.hi + shift).tolist(), shift.tolist(), strict=True)
        floors = [dict(zip(("lo", "hi", "shift"), part, strict=True)) for part in parts]
        for index, link in of_building.arcs:
            links.append({"at": (link.start[1] + shift[link.start[0]]).tolist(), "index": index, "to": link.end[0]})
    if not isinstance(source, PLR | PairPLR):
        raise ValueError(f"A page needs a PLR or a PairPLR in the plane, got {shortened(source)}.")
    if source.domain.dim != 2:
        raise ValueError(f"A page needs a PLR of 2 axes, got one of {source.domain.dim}: use plot_contours.")
    require_type("workspace", workspace, Workspace | None, "a Workspace whose walls are drawn, or None")
    # 1. Write what field.js shows as JavaScript: name and walls, and the function. Pairs and plain cones are files,
    #    which the readers below decode. Other PLRs become code.
    data = source.to_bytes()
    name = source.label or ("A building" if floors else "A PLR" if isinstance(source, PLR) else "Pairs")
    walls = None if workspace is None else {"data": obstacles_path(workspace, source.domain)}
    if workspace is not None and floors:  # drawn for each floor in another place: corners, not pixels
        rings = shapely.get_rings(shapely.get_parts(workspace.free_space))
        walls = {"isFree": True, "rings": [shapely.get_coordinates(ring)[:-1].round(9).tolist() for ring in rings]}
    facts = {"name": name, "size": plr_or_pairs.num_bytes, "walls": walls, "floors": floors, "links": links}
    content = {key: json.dumps(value) for key, value in facts.items()}
    if isinstance(source, PairPLR) or _is_plain_cone(source):
        content |= {"file": json.dumps(b64encode(data).decode())}
    else:
        box = {"lo": source.domain.lo.tolist(), "hi": source.domain.hi.tolist()}
        content |= {"box": json.dumps(box), "module": _module(data)}
    # 2. Join it with the readers and the page's own code.
    content_js = "{" + ", ".join(f"{key}: {value}" for key, value in content.items()) + "}"
    readers = [js_file_reader(), js_cone_reader(), js_pairs_reader()]
    script = "\n".join([*readers, asset("clock.js"), asset("field.js").replace("{{content}}", content_js)])
    body = asset("field.html").replace("{{play}}", PLAY)
    return Page(html_document(name, asset("field.css"), body, packed_script(script)))


def _is_plain_cone(plr: PLR) -> bool:
    """Return whether a PLR has cone leaves, and neither periodic axes nor a folding by mirror symmetries."""
    return isinstance(plr.leaf, Cone) and plr.container.folding is None and not plr.domain.is_periodic


def _module(data: bytes) -> str:
    """Return JavaScript code of an object that holds a reader of the PLR file ``data``, and numbers about the file.

    The numbers are its number of cells and its proven error.
    """
    plr = NumpyPLR(data)
    module = plr.js_module()
    error = "null" if plr.max_error is None else repr(plr.max_error).replace("inf", "Infinity")
    # A page's script cannot export: make the module the body of a function that returns what the module exports, and
    # the tree, from which the page draws the cells. The module of a PLR with one leaf has no tree.
    exported = ", ".join([*_EXPORTED.findall(module), "tree, root" if plr.num_leaves > 1 else "tree: [], root: 2"])
    code = module.replace("export function", "function") + f"\nreturn {{ {exported} }};"
    return f'{{ read: () => {{\n{code}\n}}, kind: "{plr.num_leaves:,} cells", error: {error} }}'
