"""The commands ``query``, ``info``, ``plot``, ``export`` and ``view`` for saved files, and the command ``demo``.

A file holds a PLR, or *pairs*: distances between any two points.
"""

import sys
from json import dumps
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from jaxtyping import Float

import plr_jax
from plr_jax._arrays import format_numbers
from plr_jax._files import errors_named, write_atomically
from plr_jax.cli.app import command, printable
from plr_jax.cli.build import cost_of, measure_error
from plr_jax.cli.inputs import PICTURES, check_output, oracle_of, parse_goals, read_map_of_file, read_points

FileArgument = Annotated[Path, typer.Argument(metavar="FILE")]
GoalOption = Annotated[list[str] | None, typer.Option("--goal", "-g", metavar="X,Y")]
OutputOption = Annotated[Path, typer.Option("--output", "-o")]


@command(
    "plr-jax query maze.plr points.csv",
    "plr-jax query maze.plr points.csv --bounds",
    "plr-jax query exits.plr points.csv --which",
    "echo 0.93,0.95 | plr-jax query maze.plr",
    "echo 0.93,0.95,0.1,0.1 | plr-jax query maze.pairs",
)
def query(
    file: FileArgument,
    points: Annotated[str, typer.Argument(metavar="[POINTS.csv | -]")] = "-",
    bounds: Annotated[bool, typer.Option("--bounds")] = False,
    which: Annotated[bool, typer.Option("--which")] = False,
) -> None:
    """Print the distance of each point, one per line: inf outside the domain, nan for a row that is not a point.

    Blank lines are skipped; other rows that are not points are reported on standard error. A first line of names is a
    header. Tables may have any length.

    Args:
        file: A file of a PLR or of pairs.
        points: Points, x,y in each line, in a building floor,x,y; for pairs both ends, x,y,x,y; - reads standard
            input.
        bounds: Print distance,lower,upper: the distance and its proven bounds.
        which: Add the index of the nearest of several goals: 0, 1, ...; -1 outside. In a building, the next link: 0,
            1, ...; -1 to the goal, -2 outside.
    """
    from plr_jax.buildings.floors import Floors
    from plr_jax.plr.container import BUILDING_MAGIC, holds_pairs, read_bytes

    # 1. Read the file, a PLR without importing JAX.
    with errors_named(file):
        data = read_bytes(file)
        is_building = data.startswith(BUILDING_MAGIC)
        is_pairs = holds_pairs(Floors.read(data)[1] if is_building else data)
    if is_pairs and which:
        raise ValueError(f"--which needs a file of a PLR, got pairs in {file}: leave it out.")
    reader: Any = plr_jax.load(file) if is_pairs else plr_jax.load_numpy(file)
    reader = reader.numpy() if hasattr(reader, "numpy") else reader
    # 2. Answer the points block by block.
    reads_stdin = points == "-"
    if not sys.stdin and reads_stdin:
        raise ValueError("Standard input is closed: name a file of points.")
    with sys.stdin.buffer if reads_stdin else open(points, "rb") as table:
        dim = 3 if is_building else 2 if is_pairs else reader.dim
        for x in read_points(table, "stdin" if reads_stdin else points, dim * (1 + is_pairs)):
            ends: Any = np.split(x, 1 + is_pairs, axis=1)
            if is_building:
                ends = [_place_of(rows, len(reader.floors.lo)) for rows in ends]
                ends = ends if is_pairs else ends[0]
            columns = [reader(*ends)]
            columns += reader.bounds(*ends) if bounds else ()
            columns += [reader.which(*ends)] if which else ()
            line = ",".join(["%.9g"] * len(columns)) + "\n"
            typer.echo(line * len(x) % tuple(np.column_stack(columns).ravel().tolist()), nl=False)


def _place_of(rows: Float[np.ndarray, "n 3"], num_floors: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the floors and points of rows ``floor, x, y``; points of unknown floors are NaN."""
    is_known = np.isin(rows[:, :1], np.arange(num_floors))
    return np.where(is_known, rows[:, :1], 0)[:, 0].astype(int), np.where(is_known, rows[:, 1:], np.nan)


@command("plr-jax info maze.plr", "plr-jax info maze.plr --json")
def info(file: FileArgument, json: Annotated[bool, typer.Option("--json")] = False) -> None:
    """Print the properties of a file.

    Args:
        file: A file of a PLR or of pairs.
        json: Print a JSON object.
    """
    content = plr_jax.load(file)
    plane = getattr(content, "plane", content)  # of a building, what its file holds of all floors
    domain = plane.domain
    facts: dict[str, Any] = {"file": str(file), "holds": type(content).__name__}
    facts |= {"lo": format_numbers(domain.lo), "hi": format_numbers(domain.hi)}
    facts["periodic_axes"] = [axis for axis, is_periodic in enumerate(domain.periodic) if is_periodic]
    names = ["label", "num_bytes", "num_leaves", "num_unreachable", "num_corners", "depth", "max_error"]
    facts |= {name: getattr(plane, name) for name in names if hasattr(plane, name)} | {"num_bytes": content.num_bytes}
    if isinstance(plane, plr_jax.PLR):  # building the tables of pairs may take long
        facts |= {"leaf": plane.leaf.name, "resident_bytes": plane.resident_bytes}
    lines = [f"{name:16}{printable(str(value))}" for name, value in facts.items()]
    typer.echo(dumps(facts, indent=2) if json else "\n".join(lines))


@command(
    "plr-jax plot maze.plr -o maze.png",
    "plr-jax plot maze.plr --kind error -o error.png",
    "plr-jax plot maze.pairs --goal 0.1,0.1 -o maze.png",
)
def plot(
    file: FileArgument,
    output: OutputOption,
    map: Annotated[str | None, typer.Option(metavar="MAP", show_default="the map FILE was built from")] = None,
    goal: GoalOption = None,
    kind: Literal["distance", "cells", "error"] = "distance",
) -> None:
    """Draw the distance in a file; for pairs, the distance to a goal.

    Args:
        file: A file of a PLR or of pairs.
        output: The picture to write: .png, .pdf or .svg.
        map: Map of walls (not of costs) that are drawn; it is read with the options that FILE was built with.
        goal: The goal, if FILE holds pairs.
        kind: The distance as colors and contours; the cells; the error, which needs the map.
    """
    # 1. Read the distance, and check that it can be drawn.
    check_output(output, PICTURES, inputs=(file, map))
    content = plr_jax.load(file)
    content = getattr(content, "plane", content)  # of a building, all floors side by side
    plr = _distance_of(content, file, goal)
    if plr.domain.dim != 2:
        raise ValueError(f"FILE must have 2 axes, got {plr.domain.dim} in {file}: use plot_contours with at=.")
    if not isinstance(plr, plr_jax.PLR) and kind != "distance":
        raise ValueError(f"--kind must be distance for pairs of cells of a grid, got {kind} for {file}.")
    # 2. Read the map, and draw.
    workspace, goals = read_map_of_file(file, content, map, is_needed=kind == "error")
    goals = parse_goals(goal) if goal else goals
    if kind == "distance":
        ax = plr_jax.plot.plot_contours(plr, workspace=workspace, goal=goals)
    elif kind == "cells":
        ax = plr_jax.plot.plot_cells(plr, workspace=workspace)
    elif workspace is None or goals is None:
        raise ValueError(f"{file} does not name its map and goal: use plr_jax.plot.plot_error.")
    else:
        oracle = oracle_of(workspace, goals)
        ax = plr_jax.plot.plot_error(plr_jax.metrics.error_grid(plr, oracle, workspace), workspace)
        ax.title.set_text(measure_error(plr.numpy(), oracle, workspace)[1])  # the numbers that `build` prints
    plr_jax.plot.save(ax, output)
    typer.echo(f"wrote {output}")


def _distance_of(content: Any, file: Path, goal: list[str] | None) -> Any:
    """Return a function that gives the distance to one goal: a PLR itself, or for pairs the distance to ``goal``.

    ``content`` is what was loaded from ``file``: a PLR, or pairs (distances between any two points). ``goal`` has the
    texts ``X,Y`` of the option ``--goal``. ``ValueError`` is raised if a goal is given for a PLR, or not exactly one
    goal for pairs.
    """
    if isinstance(content, plr_jax.PLR | plr_jax.buildings.BuildingPLR):
        if goal:
            raise ValueError(f"{file} is a PLR with a fixed goal: leave out --goal.")
        return content
    if not hasattr(content, "to"):
        raise ValueError(f"{file} has the distance between any two places of a building: build a PLR of one goal.")
    if not goal or len(goal) > 1:
        raise ValueError(f"{file} has the distance between any two points: give one of them with --goal X,Y.")
    return content.to(parse_goals(goal)[0])


@command(
    "plr-jax export maze.plr -o plr_maze.h",
    "plr-jax export maze.plr --compact -o maze.h",
    "plr-jax export maze.pairs --goal 0.1,0.1 -o maze.h",
    "plr-jax export maze.plr --js -o maze.mjs",
    "plr-jax export grid.pairs -o grid.h",
)
def export(
    file: FileArgument,
    output: OutputOption,
    goal: GoalOption = None,
    js: Annotated[bool, typer.Option("--js/--c")] = False,
    compact: Annotated[bool, typer.Option("--compact")] = False,
) -> None:
    """Write a file as code without dependencies. The code's answers equal those of the command query, bit for bit.

    Pairs (a file of distances between any two points) become the distance to one goal, or, in JavaScript without a
    goal, the distance between any two points. Pairs of cells of a grid become a header that gives the number of steps
    between any two cells; it reads a file of tables, which is written beside it.

    Args:
        file: A file of a PLR or of pairs.
        output: The file to write. Its name begins all names in a header.
        goal: The goal, if FILE holds pairs.
        js: Write a JavaScript module, or a C99 header, which is also valid C++.
        compact: Write a header for small machines: less memory, slower.
    """
    check_output(output, (".mjs", ".js") if js else (".h", ".hpp"), inputs=(file,))
    if js and compact:
        raise ValueError("--compact is for C headers: leave it out.")
    content, costs = plr_jax.load(file), []
    if hasattr(content, "window"):  # pairs of a grid: a header, and a file of tables beside it
        if js or goal or compact:
            reason = f"{file} holds pairs of cells of a grid, which become a C header for any goal"
            raise ValueError(f"{reason}: leave out --js, --goal and --compact.")
        check_output(tables := output.with_suffix(".tables"), inputs=(file,))
        header = content.c_header(output.stem)
        write_atomically(tables, header.table)
        typer.echo(f"wrote {tables}: {len(header.table):,} bytes")
        text = header.text
    elif js:  # a module of pairs may keep both ends free
        distance = content if hasattr(content, "to") and not goal else _distance_of(content, file, goal)
        if not hasattr(distance, "js_module"):
            kinds = "a C header or, by view, a page"
            raise ValueError(f"{file} is a PLR of a building, which becomes {kinds}: not --js.")
        text = distance.js_module()
    else:
        distance = _distance_of(content, file, goal)
        text, costs = distance.c_header(output.stem, compact=compact), cost_of(distance, compact)
    write_atomically(output, text.encode())
    typer.echo("\n        ".join([f"wrote {output}: {len(text):,} bytes of text", *costs]))


@command("plr-jax view maze.plr", "plr-jax view maze.plr maze -o page.html", "plr-jax view maze.pairs")
def view(
    file: FileArgument,
    map: Annotated[str | None, typer.Argument(metavar="[MAP]", show_default="the map FILE was built from")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", show_default="FILE's name with .html")] = None,
) -> None:
    """Write an interactive web page that shows the distance in a file at the mouse pointer, and needs no network.

    Args:
        file: A file of a PLR or of pairs.
        map: Map whose obstacles are drawn, as --map of plot; pairs have their own.
        output: The page to write.
    """
    output = output or Path(f"{file.stem}.html")
    check_output(output, (".html",), inputs=(file, map))
    content = plr_jax.load(file)
    plane = getattr(content, "plane", content)
    workspace = read_map_of_file(file, plane, map)[0] if map is not None or isinstance(plane, plr_jax.PLR) else None
    written = plr_jax.plot.page(content, workspace)
    written.save(output)
    typer.echo(f"wrote {output}: {len(written.html.encode()):,} bytes; open it in a browser")


@command("plr-jax demo --output pictures")
def demo(output: OutputOption = Path("plr_jax_demo")) -> None:
    """Compress the distance in a maze to 1 KB, compare it with the exact one, and draw it; plan for four robots.

    Args:
        output: Folder to write to.
    """
    from plr_jax.cli.demo import run

    run(output)
