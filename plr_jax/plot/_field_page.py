"""Pages on which one sees a distance function, asks it, and lets swarms flow along it."""

import json
import os
import re
from base64 import b64encode
from dataclasses import dataclass
from pathlib import Path

from plr_jax._arrays import shortened
from plr_jax._files import write_atomically
from plr_jax.geometry.workspace import Workspace
from plr_jax.pairs import PairPLR
from plr_jax.pairs.portable import js_pairs_reader
from plr_jax.plot._html import PLAY, document, framed, obstacles_path, packed_script, part
from plr_jax.plr import PLR, NumpyPLR
from plr_jax.plr.container import Container
from plr_jax.plr.leaves import leaf_of_code
from plr_jax.plr.leaves.base import SourcedLeafModel
from plr_jax.plr.portable.javascript import js_cone_reader, js_file_reader

_FRAME = (560, 900)  # pixels of a page inside another one
_EXPORTED = re.compile(r"^export function (\w+)", re.MULTILINE)


@dataclass(frozen=True, eq=False)
class Page:
    """A page that shows a distance function, as :func:`page` makes it. In a notebook it shows itself.

    Args:
        html: The whole page.
    """

    html: str

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page.

        Args:
            path: The file, which ends in ``.html``.

        Raises:
            ValueError: If the ending is another one.
            OSError: If the file cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() != ".html":
            raise ValueError(f"A page is written as .html, got {str(path)!r}.")
        write_atomically(path, self.html.encode())

    def __repr__(self) -> str:
        return f"Page({len(self.html.encode()):,} bytes)"

    def _repr_html_(self) -> str:
        return framed(self.html, *_FRAME)


def page(plr_or_pairs: PLR | PairPLR, workspace: Workspace | None = None) -> Page:
    """A distance function as one page for a browser, which loads nothing and works without a server.

    It shows the distance as colors and contours, the walls, and the cells on demand. Under the pointer it tells the
    distance, its proven bounds, and the path: of cones from source to source, of other leaves down the slope, never
    into a wall that is given. A click lets a swarm flow to the goal. Of pairs both ends can be dragged. Other files
    of cones or pairs may be dropped on the page. Its answers are those of ``plr.numpy()`` and ``pairs.numpy()``, bit
    for bit.

    Args:
        plr_or_pairs: What is shown, in the plane.
        workspace: What walls are drawn. Pairs bring their own.

    Returns:
        The page, to be saved or shown in a notebook.

    Raises:
        ValueError: If it is none of those, or not in the plane.
    """
    held = plr_or_pairs
    if not isinstance(held, PLR | PairPLR):
        raise ValueError(f"A page shows a PLR or pairs of points in the plane, got {shortened(held)}.")
    if held.domain.dim != 2:
        raise ValueError(
            f"A page shows the plane, got a PLR of {held.domain.dim} axes; see plr_jax.plot.slices for others."
        )
    if not isinstance(workspace, Workspace | None):
        raise ValueError(
            f"workspace must be the Workspace whose walls are drawn, or None, got {shortened(workspace)}."
        )
    data, name = held.to_bytes(), held.label or ("A PLR" if isinstance(held, PLR) else "Pairs")
    walls = None if workspace is None else {"data": obstacles_path(workspace, held.domain)}
    content = {"name": json.dumps(name), "walls": json.dumps(walls)}
    if isinstance(held, PairPLR) or _is_read_there(data):
        content |= {"file": json.dumps(b64encode(data).decode())}
    else:
        box = {"lo": held.domain.lo.tolist(), "hi": held.domain.hi.tolist()}
        content |= {"box": json.dumps(box), "modules": f"[{_module(data)}]"}
    told = "{" + ", ".join(f"{key}: {value}" for key, value in content.items()) + "}"
    readers = [js_file_reader(), js_cone_reader(), js_pairs_reader()]
    script = "\n".join([*readers, part("clock.js"), part("field.js").replace("{{content}}", told)])
    return Page(
        document(name, part("field.css"), part("field.html").replace("{{play}}", PLAY), packed_script(script))
    )


def _is_read_there(data: bytes) -> bool:
    """Whether the page itself reads a file."""
    container = Container.from_bytes(data)
    is_plain = container.folding is None and not container.domain.is_periodic
    return is_plain and isinstance(leaf_of_code(container.last.leaf_code), SourcedLeafModel)


def _module(data: bytes) -> str:
    """The reader of a file as an entry of the page's list of those."""
    plr = NumpyPLR(data)
    text, leaves = plr.js_module(), f"{plr.num_leaves:,} cells"
    error = "null" if plr.max_error is None else repr(plr.max_error).replace("inf", "Infinity")
    tree = "tree, root" if plr.num_leaves > 1 else "tree: [], root: 2"
    exported = ", ".join([*_EXPORTED.findall(text), tree])
    code = text.replace("export function", "function") + f"\nreturn {{ {exported} }};"
    return f"{{ read: () => {{\n{code}\n}}, size: {len(data)}, kind: {json.dumps(leaves)}, error: {error} }}"
