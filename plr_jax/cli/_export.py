"""The commands that write a distance function as a program: export, view."""

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from plr_jax.cli._app import command
from plr_jax.cli._held import file_holds_pairs, goal_of_pairs, loaded
from plr_jax.cli._inputs import require_writable
from plr_jax.cli._maps import read_map_of_file
from plr_jax.cli._options import (
    DropSpecksOption,
    FileArgument,
    GoalOfPairsOption,
    PolygonsOption,
    RadiusOption,
    ResolutionOption,
    ThresholdOption,
)


@command(
    "plr-jax export maze.plr -o plr_maze.h",
    "plr-jax export maze.plr -o include/maze.h --name level_1",
    "plr-jax export maze.pairs --goal 0.1,0.1 -o maze.h",
    "plr-jax export maze.plr --js -o maze.mjs",
    "plr-jax export grid.pairs -o grid.h",
)
def export(
    file: FileArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="The file to write.", show_default=False)],
    goal: GoalOfPairsOption = None,
    js: Annotated[
        bool,
        typer.Option("--js/--c", help="As one module of JavaScript, or as one header of C99, also valid C++."),
    ] = False,
    name: Annotated[
        str | None,
        typer.Option(
            help="With which all that a header defines begins.", show_default="the header's without its ending"
        ),
    ] = None,
    tables: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Of pairs of a grid: where the tables are written (.tables, .bin).",
            show_default="beside the header",
        ),
    ] = None,
) -> None:
    """Write a file as code that answers points, bit for bit what query prints, and needs nothing else.

    Of pairs, the distance to one goal; as JavaScript, without one, that between any two points. Of pairs of a grid,
    steps between any two cells: their header reads a file of tables, which programs map, by default beside it.
    """
    from plr_jax._atomic import write_atomically
    from plr_jax.plr import load_numpy

    require_writable(output, (".mjs", ".js") if js else (".h", ".hpp"), inputs=(file,))
    if js and name is not None:
        raise ValueError("--name is for headers of C: a module exports one name.")
    is_of_pairs = file_holds_pairs(file)
    held: Any = loaded(file) if is_of_pairs else load_numpy(file)
    if is_of_grid := hasattr(held, "window"):
        if js:
            raise ValueError(f"{file} holds pairs of cells of a grid, of which no module of JavaScript is written.")
        if goal is not None:
            raise ValueError(f"{file} holds pairs of cells of a grid, whose code answers all: leave out --goal.")
        tables = tables or output.with_suffix(".tables")
    elif tables is not None:
        raise ValueError(
            f"--tables is for pairs of cells of a grid, whose tables are a file; leave it out for {file}."
        )
    elif is_of_pairs and not (js and goal is None):
        held = goal_of_pairs(held, file, goal)
    elif goal is not None:
        raise ValueError(f"{file} is of the goal that it was built for: leave out --goal.")
    require_writable(tables, (".tables", ".bin"), inputs=(file,))
    name = output.stem if name is None else name
    if js:
        text, table = held.js_module(), b""
    elif is_of_grid:
        header = held.c_header(name)
        text, table = header.text, header.table
    else:
        text, table = held.c_header(name), b""
    told = f"wrote {output}: {len(text):,} bytes of text"
    if tables is not None:
        write_atomically(tables, table)
        told += f", and {tables}: {len(table):,} bytes"
    elif not js:
        told += ", {} of tables when it is compiled".format(*re.findall(r"tables take ([\d,]+) bytes", text))
    write_atomically(output, text.encode())
    typer.echo(told)


@command(
    "plr-jax view maze.plr",
    "plr-jax view maze.plr maze -o page.html",
    "plr-jax view maze.pairs",
)
def view(
    file: FileArgument,
    map: Annotated[
        str | None,
        typer.Argument(
            metavar="[MAP]",
            help="Draw this map's obstacles; pairs bring their own.",
            show_default="what FILE was built of",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The page to write.", show_default="FILE's name with .html"),
    ] = None,
    resolution: ResolutionOption = None,
    threshold: ThresholdOption = None,
    drop_specks: DropSpecksOption = None,
    polygons: PolygonsOption = None,
    radius: RadiusOption = None,
) -> None:
    """Write a file as a page for a browser, which shows the distance and answers the pointer, without a network."""
    from plr_jax.plot import page

    output = output or Path(f"{file.stem}.html")
    require_writable(output, (".html",), inputs=(file, map))
    held, workspace = loaded(file), None
    if map is not None or not file_holds_pairs(file):
        reading = {"threshold": threshold, "drop_specks": drop_specks, "polygons": polygons, "radius": radius}
        reading["resolution"] = resolution
        workspace, _ = read_map_of_file(file, held, map, goal=None, is_needed=False, **reading)
    written = page(held, workspace)
    written.save(output)
    typer.echo(f"wrote {output}: {len(written.html.encode()):,} bytes; open it in a browser")
