"""The commands ``query``, ``info``, ``plot``, ``export`` and ``view`` for files of PLRs or pairs; and ``demo``."""

import re
import sys
from enum import StrEnum
from json import dumps
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from plr_jax.cli.app import command, printable
from plr_jax.cli.inputs import (
    PICTURES,
    FileArgument,
    GoalOption,
    joined_goals,
    oracle_of,
    parse_goals,
    read_map_of_file,
    require_writable,
)
from plr_jax.cli.rows import open_table, print_answers, read_points


def _holds_pairs(file: Path) -> bool:
    from plr_jax.plr.container import holds_pairs, read_bytes

    try:
        return holds_pairs(read_bytes(file))
    except ValueError:  # the reader of the file gives a better error
        return False


def _distance_to_goal(pairs: Any, file: Path, goal: list[str] | None) -> Any:
    goals = [] if goal is None else parse_goals(str(joined_goals(goal)))
    if len(goals) != 1:
        raise ValueError(f"{file} has the distance between any two points: give one of them with --goal X,Y.")
    return pairs.to(goals[0])


@command(
    "plr-jax query maze.plr points.csv",
    "plr-jax query maze.plr points.csv --bounds",
    "plr-jax query exits.plr points.csv --which",
    "echo 0.93,0.95 | plr-jax query maze.plr",
    "echo 0.93,0.95,0.1,0.1 | plr-jax query maze.pairs",
)
def query(
    file: FileArgument,
    points: Annotated[
        str,
        typer.Argument(
            metavar="[POINTS.csv | -]",
            help="Points, x,y in each line; for pairs both ends, x,y,x,y; - reads standard input.",
        ),
    ] = "-",
    gradient: Annotated[
        bool, typer.Option("--gradient", help="Print distance,dx,dy: the distance and its gradient.")
    ] = False,
    bounds: Annotated[
        bool, typer.Option("--bounds", help="Print distance,lower,upper: the distance and its proven bounds.")
    ] = False,
    which: Annotated[
        bool, typer.Option("--which", help="Add the index of the nearest of several goals: 0, 1, ...; -1 outside.")
    ] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Stop at the first row that is not a point.")] = False,
) -> None:
    """Print the distance of each point, one per line: inf outside the domain, nan for a row that is not a point.

    Blank lines are skipped; other rows that are not points are reported on standard error. A first line of names is a
    header. Tables may have any length.
    """
    if sys.stdout is None:
        raise ValueError("Standard output is closed: open it to get answers.")
    is_pairs = _holds_pairs(file)
    if is_pairs and (gradient or which):
        raise ValueError(f"--gradient and --which need a file of a PLR, got pairs in {file}: leave them out.")
    reader, gradients = _reader(file, is_pairs), _gradients(file) if gradient else None
    if which:
        try:
            reader.which(reader.domain.lo)
        except ValueError as error:
            remedy = "build it with --leaf cone and several --goal"
            raise ValueError(f"{file} does not store which goal is nearest: {remedy}.") from error
    if bounds and not is_pairs and reader.max_error is None:
        raise ValueError(f"--bounds needs a file with proven bounds, such as plr-jax build writes, got {file}.")

    def answers(x: np.ndarray) -> np.ndarray:
        ends = np.split(x, 2, axis=1) if is_pairs else [x]
        columns = [reader(*ends)]
        columns += [gradients(x)] if gradients is not None else []
        columns += reader.bounds(*ends) if bounds else []
        columns += [reader.which(x)] if which else []
        return np.column_stack(columns)

    name, table = open_table(points)
    with table:
        print_answers(map(answers, read_points(table, name, 4 if is_pairs else reader.dim, strict)))


def _reader(file: Path, is_pairs: bool) -> Any:
    if not is_pairs:
        from plr_jax.plr import load_numpy

        return load_numpy(file)
    from plr_jax import load

    pairs = load(file)
    return pairs.numpy() if hasattr(pairs, "numpy") else pairs


def _gradients(file: Path) -> Any:
    import jax

    from plr_jax import load
    from plr_jax._arrays import padded, padded_size

    compiled = jax.jit(jax.vmap(jax.grad(load(file))))

    def gradients(x: np.ndarray) -> np.ndarray:
        found = np.asarray(compiled(padded(x, padded_size(len(x)))))[: len(x)]
        return np.where(np.isnan(x).any(axis=1, keepdims=True), np.nan, found)

    return gradients


@command("plr-jax info maze.plr", "plr-jax info maze.plr --json")
def info(
    file: FileArgument, json: Annotated[bool, typer.Option("--json", help="Print a JSON object.")] = False
) -> None:
    """Print the properties of a file."""
    from plr_jax import load
    from plr_jax._arrays import format_numbers
    from plr_jax.plr import PLR

    content = load(file)
    domain = content.domain
    facts: dict[str, Any] = {"file": str(file), "holds": type(content).__name__}
    facts |= {"lo": format_numbers(domain.lo), "hi": format_numbers(domain.hi)}
    facts["periodic_axes"] = [axis for axis, is_periodic in enumerate(domain.periodic) if is_periodic]
    names = ["label", "num_bytes", "num_leaves", "num_unreachable", "num_corners", "depth", "max_error"]
    facts |= {name: getattr(content, name) for name in names if hasattr(content, name)}
    if isinstance(content, PLR):  # building the tables of pairs may take long
        facts |= {"leaf": content.leaf.name, "resident_bytes": content.resident_bytes}
    if json:
        typer.echo(dumps(facts, indent=2))
        return
    periodic = f", periodic along axes {facts['periodic_axes']}" if facts["periodic_axes"] else ""
    lines = {"file": facts["file"], "label": facts.get("label") or "none"}
    lines["leaf" if "leaf" in facts else "holds"] = facts.get("leaf", facts["holds"])
    lines["domain"] = f"{facts['lo']} to {facts['hi']} ({domain.dim}-D{periodic})"
    num_bytes = f"{facts['num_bytes']:,} in the file"
    if "leaf" in facts:
        lines["leaves"] = f"{facts['num_leaves']:,}, of which {facts['num_unreachable']:,} unreachable"
        lines["depth"] = str(facts["depth"])
        proven = facts["max_error"]
        lines["proof"] = "none" if proven is None else f"largest error {proven:.3g}"
        num_bytes += f", {facts['resident_bytes']:,} in memory"
    else:
        lines["corners"] = f"{facts['num_corners']:,}"
    lines["bytes"] = num_bytes
    typer.echo("\n".join(f"{name:11}{printable(text)}" for name, text in lines.items()))


class Picture(StrEnum):
    distance = "distance"
    cells = "cells"
    surface = "surface"
    error = "error"


MapOption = Annotated[
    str | None,
    typer.Option(
        metavar="MAP",
        help="Map of walls (not of costs) that are drawn, with options of its reader: 'scan.png --resolution=0.05'.",
        show_default="the map FILE was built from",
    ),
]


@command(
    "plr-jax plot maze.plr -o maze.png",
    "plr-jax plot maze.plr --kind error -o error.png",
    "plr-jax plot maze.pairs --goal 0.1,0.1 -o maze.png",
)
def plot(
    file: FileArgument,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The picture to write: .png (the default ending), .pdf or .svg.")
    ],
    map: MapOption = None,
    goal: GoalOption = None,
    kind: Annotated[
        Picture,
        typer.Option(
            help="The distance as colors and contours; the cells; a 3-D surface; the error, which needs the map."
        ),
    ] = Picture.distance,
) -> None:
    """Draw the distance in a file; for pairs, the distance to a goal."""
    from plr_jax import load, metrics
    from plr_jax import plot as draw
    from plr_jax.plr import PLR

    output = output if output.suffix else output.with_name(f"{output.name}.png")
    require_writable(output, PICTURES, inputs=(file, map))
    content = load(file)
    is_pairs = not isinstance(content, PLR)
    plr = _distance_to_goal(content, file, goal) if is_pairs else content
    if plr.domain.dim != 2:
        raise ValueError(f"FILE must have 2 axes, got {plr.domain.dim} in {file}: use plr_jax.plot.slices.")
    if not isinstance(plr, PLR) and kind is not Picture.distance:
        raise ValueError(f"--kind must be distance for pairs of cells of a grid, got {kind} for {file}.")
    text = joined_goals(goal)
    workspace, target = read_map_of_file(
        file, content, map, None if is_pairs else text, is_needed=kind is Picture.error
    )
    target = parse_goals(str(text)) if is_pairs else target
    match kind:
        case Picture.distance:
            ax = draw.plot_contours(plr, workspace=workspace, goal=target)
        case Picture.cells:
            ax = draw.plot_cells(plr, workspace=workspace)
        case Picture.surface:
            ax = draw.plot_surface(plr, workspace=workspace)
        case Picture.error:
            if workspace is None or target is None:
                raise ValueError(f"{file} does not name its map and goal: give --map, and --goal X,Y.")
            ax = draw.plot_error(metrics.error_grid(plr, oracle_of(workspace, target), workspace), workspace)
    draw.save(ax, output)
    typer.echo(f"wrote {output}")


@command(
    "plr-jax export maze.plr -o plr_maze.h",
    "plr-jax export maze.plr -o include/maze.h --name level_1",
    "plr-jax export maze.plr --compact -o maze.h",
    "plr-jax export maze.pairs --goal 0.1,0.1 -o maze.h",
    "plr-jax export maze.plr --js -o maze.mjs",
    "plr-jax export grid.pairs -o grid.h",
)
def export(
    file: FileArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="The file to write.", show_default=False)],
    goal: GoalOption = None,
    js: Annotated[
        bool, typer.Option("--js/--c", help="Write a JavaScript module, or a C99 header, which is also valid C++.")
    ] = False,
    name: Annotated[
        str | None,
        typer.Option(help="Prefix of all names in a header.", show_default="the header's name without its ending"),
    ] = None,
    compact: Annotated[
        bool, typer.Option("--compact", help="Write a header for small machines: less memory, slower.")
    ] = False,
) -> None:
    """Write a file as code without dependencies, whose answers equal those of query, bit for bit.

    Pairs (a file of distances between any two points) become the distance to one goal, or, in JavaScript without a
    goal, the distance between any two points. Pairs of a grid become a header that gives the steps between any two
    cells; it reads a file of tables, which is written beside it.
    """
    from plr_jax import load
    from plr_jax._files import write_atomically
    from plr_jax.plr import load_numpy

    require_writable(output, (".mjs", ".js") if js else (".h", ".hpp"), inputs=(file,))
    if js and name is not None:
        raise ValueError("--name is for C headers, JavaScript modules have fixed names: leave it out.")
    if js and compact:
        raise ValueError("--compact is for C headers: leave it out.")
    is_pairs = _holds_pairs(file)
    content: Any = load(file) if is_pairs else load_numpy(file)
    prefix = output.stem if name is None else name
    if hasattr(content, "window"):  # pairs of a grid
        if js:
            raise ValueError(f"{file} holds pairs of cells of a grid, which only C headers support: leave out --js.")
        if goal is not None:
            raise ValueError(f"{file} holds pairs of cells of a grid, whose code answers any goal: leave out --goal.")
        if compact:
            raise ValueError(f"{file} holds pairs of cells of a grid, whose code is small: leave out --compact.")
        require_writable(tables := output.with_suffix(".tables"), inputs=(file,))
        header = content.c_header(prefix)
        write_atomically(tables, header.table)
        write_atomically(output, header.text.encode())
        typer.echo(f"wrote {output}: {len(header.text):,} bytes of text, and {tables}: {len(header.table):,} bytes")
        return
    if is_pairs and not (js and goal is None):
        content = _distance_to_goal(content, file, goal)
    elif goal is not None:
        raise ValueError(f"{file} is a PLR with a fixed goal: leave out --goal.")
    text = content.js_module() if js else content.c_header(prefix, compact)
    write_atomically(output, text.encode())
    (tables,) = [None] if js else re.findall(r"tables take ([\d,]+) bytes", text)
    compiled = "" if js else f", {tables} of tables when it is compiled"
    typer.echo(f"wrote {output}: {len(text):,} bytes of text{compiled}")


@command("plr-jax view maze.plr", "plr-jax view maze.plr maze -o page.html", "plr-jax view maze.pairs")
def view(
    file: FileArgument,
    map: Annotated[
        str | None,
        typer.Argument(
            metavar="[MAP]",
            help="Map whose obstacles are drawn, as --map of plot; pairs have their own.",
            show_default="the map FILE was built from",
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The page to write.", show_default="FILE's name with .html")
    ] = None,
) -> None:
    """Write an interactive web page of a file, which shows the distance at the pointer and needs no network."""
    from plr_jax import load
    from plr_jax.plot import page

    output = output or Path(f"{file.stem}.html")
    require_writable(output, (".html",), inputs=(file, map))
    content, workspace = load(file), None
    if map is not None or not _holds_pairs(file):
        workspace, _ = read_map_of_file(file, content, map, None, is_needed=False)
    written = page(content, workspace)
    written.save(output)
    typer.echo(f"wrote {output}: {len(written.html.encode()):,} bytes; open it in a browser")


@command("plr-jax demo --output pictures")
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to.")] = Path("plr_jax_demo"),
) -> None:
    """Compress a maze, compare it with the exact distance, and draw it; plan for four robots."""
    from plr_jax.cli.demo import run

    run(output)
