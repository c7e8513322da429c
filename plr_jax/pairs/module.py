"""Pairs as a module of JavaScript: their file, and a program that reads and asks it."""

from base64 import b64encode
from pathlib import Path

from plr_jax.geometry.box import Box
from plr_jax.pairs.portable import crossings, straight_length, straight_line_of, winding
from plr_jax.plr.container import Container, Header
from plr_jax.plr.portable.javascript import NAMED_NUMBERS, JavaScriptWriter, function, js_file_reader, tables_axes
from plr_jax.plr.portable.writers import Text, ends_of, indented

_PAIRS_READER = Path(__file__).with_name("pairs.js")


def js_pairs_reader() -> str:
    """Functions of JavaScript that read files of pairs, and make a reader of what they find."""
    text = _PAIRS_READER.read_text(encoding="utf-8")
    return text.replace("{{numbers}}", NAMED_NUMBERS).replace("{{arithmetic}}", "\n".join(indented(_arithmetic())))


def js_pairs_module(data: bytes, domain: Box) -> str:
    """The module of a file of pairs: see :meth:`PairPLR.js_module`."""
    require_lists(data)
    return f"""\
// The distance between any two points of {ends_of(domain)}, by plr_jax.
//
// distance([x, y], [x, y]): Infinity outside this closed domain and where no path leads, NaN where a coordinate is.
// waypoint(from, to): where to go straight to from a point towards another one; NaN where no way leads.
// bounds([x, y], [x, y]): proven bounds of the distance between points of free space, [lower, upper].
// Answers are those of pairs.numpy(), bit for bit.

{js_file_reader()}
{js_pairs_reader()}
const file = Uint8Array.from(atob("{b64encode(data).decode()}"), letter => letter.charCodeAt(0));
export const {{ distance, waypoint, bounds }} = pairsReader(readPairs(readContainer(file), file.length));
"""


def require_lists(data: bytes) -> None:
    """Raise ``ValueError`` where a file of pairs was cut off before its last layer."""
    layers, marks = len(Container.from_bytes(data).layers), len(Header.read(data).marks)
    if layers <= marks:
        raise ValueError("The file was cut off before its lists of corners, which this needs: take the whole file.")


def _arithmetic() -> list[str]:
    """The functions of single numbers."""
    lines: list[str] = []
    for name, axis in zip(("placeX", "placeY"), tables_axes(JavaScriptWriter()), strict=True):
        do = JavaScriptWriter()
        place = axis.place(do, do.let("above", axis.above(do.atom("x"))))
        lines += function(f"function {name}(x)", [*do.statements, f"return {place};"])
    do = JavaScriptWriter()
    p, q = ([do.atom(f"{end}{axis}") for axis in "xy"] for end in "pq")
    length = straight_length(do, p, q)
    lines += function("function legLength(px, py, qx, qy)", [*do.statements, f"return {length};"])
    outer, do = JavaScriptWriter(), JavaScriptWriter()
    goes_in, goes_out = crossings(do, p, q, straight_line_of(outer, p, q), _wall(do))
    lines += function(
        "function hides({ walls, isCertain }, px, py, qx, qy)",
        [
            *outer.statements,
            "let goesIn = false, goesOut = false;",
            *_for_each_wall([*do.statements, f"if ({goes_in}) goesIn = true;", f"if ({goes_out}) goesOut = true;"]),
            "return isCertain ? goesIn || goesOut : goesIn && goesOut;",
        ],
    )
    do = JavaScriptWriter()
    up, down = winding(do, p, _wall(do))
    lines += function(
        "function encloses({ walls }, px, py)",
        [
            "let turns = 0;",
            *_for_each_wall([*do.statements, f"if ({up}) turns++;", f"if ({down}) turns--;"]),
            "return turns === 1;",
        ],
    )
    return lines


def _wall(do: JavaScriptWriter) -> list[Text]:
    return [do.atom(f"walls[w + {i}]" if i else "walls[w]") for i in range(7)]


def _for_each_wall(statements: list[str]) -> list[str]:
    return ["for (let w = 0; w < walls.length; w += 7) {", *indented(statements), "}"]
