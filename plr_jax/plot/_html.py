"""Pages for a browser: one file each, which loads nothing; and what they share with one another."""

import html
import zlib
from base64 import b64encode
from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float

from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace
from plr_jax.plot._page import INK
from plr_jax.plot._plane import OBSTACLE, blocked_polygons

SIZE = 520.0
"""Pixels along the longer side of the bounds, before the browser scales them."""
BORDER = 2.0
"""Pixels around them."""
PLAY = '<button id="play" aria-label="Play or pause"><svg viewBox="0 0 14 14"><path id="icon"/></svg></button>'
"""The button of ``clock.js``."""


def part(name: str) -> str:
    """A part of pages, from a file of this folder."""
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def document(title: str, style: str, body: str, script: str) -> str:
    """A page of its parts; ``page.css`` comes before its style."""
    filled = {
        "style": part("page.css").replace("{{ink}}", INK).replace("{{obstacle}}", OBSTACLE) + style,
        "body": body,
        "script": script,
        "title": html.escape(title),  # last, as it may be in braces itself
    }
    page = part("page.html")
    for name, value in filled.items():
        page = page.replace("{{" + name + "}}", value)
    return page


def packed_script(script: str) -> str:
    """A script that runs another one, of which it has no comments nor indentation, in a third of its bytes."""
    lines = (line.strip() for line in script.splitlines())
    bare = "\n".join(line for line in lines if line and not line.startswith("//"))
    packer = zlib.compressobj(9, wbits=-15)
    data = b64encode(packer.compress(bare.encode()) + packer.flush()).decode()
    return f"""\
const packed = Uint8Array.from(atob("{data}"), letter => letter.charCodeAt(0));
new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"))).text().then(text => {{
    const script = document.createElement("script");
    script.textContent = text;
    document.body.append(script);
}});
"""


def framed(page: str, width: float | int, height: float | int) -> str:
    """A page in a frame of its own, so that many fit on one page and none sees the others."""
    looks = f'width="{width:.0f}" height="{height:.0f}" sandbox="allow-scripts" style="border:0;max-width:100%"'
    return f'<iframe srcdoc="{html.escape(page)}" {looks}></iframe>'


def pixel_scale(bounds: Box) -> float:
    """Pixels a workspace unit."""
    return SIZE / float(bounds.width.max())


def view_of(bounds: Box) -> dict[str, float]:
    """What scripts need to know to place points."""
    return {"scale": pixel_scale(bounds), "left": float(bounds.lo[0]), "top": float(bounds.hi[1])}


def pixels(bounds: Box, points: Float[np.ndarray, "n 2"]) -> str:
    """Points in pixels, y downward."""
    scale = pixel_scale(bounds)
    x, y = scale * (points[:, 0] - bounds.lo[0]), scale * (bounds.hi[1] - points[:, 1])
    return " ".join(f"{a:.2f},{b:.2f}" for a, b in zip(x, y, strict=True))


def obstacles_path(workspace: Workspace, bounds: Box) -> str:
    """What obstacles cover, as data of a path in pixels of some bounds, to be filled by the rule of even and odd."""
    rings = []
    for polygon in blocked_polygons(workspace):
        for ring in (polygon.exterior, *polygon.interiors):
            rings.append(f"M{pixels(bounds, shapely.get_coordinates(ring)[:-1])}Z")
    return "".join(rings)


def view_box(bounds: Box) -> str:
    """The box that a picture shows, in pixels."""
    width, height = pixel_scale(bounds) * bounds.width
    return f"{-BORDER:g} {-BORDER:g} {width + 2 * BORDER:.1f} {height + 2 * BORDER:.1f}"
