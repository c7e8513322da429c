"""The commands about one distance function: build, query, info, plot; and what calls the demo.

Heavy libraries are imported inside the commands, so that ``plr-jax --help`` answers at once.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from plr_jax.cli import INTERRUPTED_EXIT
from plr_jax.cli._app import command, printable, saying
from plr_jax.cli._build import build_file, prepared_oracle
from plr_jax.cli._facts import facts_of, lines_of
from plr_jax.cli._held import file_holds_pairs, goal_of_pairs, loaded
from plr_jax.cli._inputs import DEFAULT_BYTES, LEAVES, PICTURES, parse_goal, require_writable
from plr_jax.cli._maps import NamedMap, read_map_of_file, say_vertices
from plr_jax.cli._options import (
    BoxOption,
    DropSpecksOption,
    EnclosedOption,
    FileArgument,
    GoalOfPairsOption,
    GoalOption,
    MapArgument,
    PolygonsOption,
    RadiusOption,
    ResolutionOption,
    ThresholdOption,
    one_of,
)
from plr_jax.cli._rows import PointTable, open_table, print_answers, require_standard_output
from plr_jax.cli._volumes import VOLUME_LEAVES, NamedVolume, build_volume, is_volume

if TYPE_CHECKING:
    from plr_jax.pairs import GridPairs, PairPLR

_ERROR_POINTS = 20_000


@command(
    "plr-jax build maze -o maze.plr --max-bytes 2048",
    "plr-jax build floor_plan --leaf cone --max-bytes 1024 --leaf-bounds",
    "plr-jax build arena.map --goal 10.5,30 --oracle arena.npz",
    "plr-jax build scan.png --goal 10.5,30 --resolution 0.05 --drop-specks 4",
    "plr-jax build scan.png --goal 10.5,30 --resolution 0.05 --radius 0.3",
    "plr-jax build floor_plan --max-bytes 65536 --prefix 1024 --prefix 8192",
    "plr-jax build cave.3dmap --goal 10.5,30.5,4.5 --max-bytes 16384",
    "plr-jax build hall.stl --goal 1,2,0.5 --resolution 0.1 --enclosed free --radius 0.2",
)
def build(
    map: MapArgument,
    goal: GoalOption = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The file to write.", show_default="MAP's name with .plr"),
    ] = None,
    max_bytes: Annotated[
        int | None,
        typer.Option(help="Largest size of the file.", show_default=f"{DEFAULT_BYTES} where no limit is given"),
    ] = None,
    max_leaves: Annotated[
        int | None,
        typer.Option(help="Largest number of cells; of volumes, of those that are solved.", show_default=False),
    ] = None,
    max_depth: Annotated[int | None, typer.Option(help="Largest depth of the tree.", show_default=False)] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Error (workspace units) at which to stop: proven for planes and cones, sampled for others; of "
            "volumes the mean one of the lower bound, as estimated.",
            show_default=False,
        ),
    ] = None,
    leaf: Annotated[
        str,
        typer.Option(
            help="What a cell holds: a 'plane'; 'continuous', a function that does not jump where one can walk; "
            "'smooth', one whose gradient does not either; 'cone', the distance to the next corner. 'best' is cones "
            "where the file has room for all corners and leaves are not limited; else it builds all of them (cones "
            "if a quarter of the corners has room), and keeps that of the least proven error. Volumes are of "
            "'continuous' ones.",
            **one_of(LEAVES),
        ),
    ] = "best",
    leaf_bounds: Annotated[
        bool,
        typer.Option("--leaf-bounds", help="Prove bounds of every cell, 2 bytes each, beside the largest error."),
    ] = False,
    oracle: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="What is found about the map before it is compressed: read from FILE, or written to it where there "
            "is none, for other goals to begin with.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the sample pattern.")] = 0,
    resolution: ResolutionOption = None,
    threshold: ThresholdOption = None,
    drop_specks: DropSpecksOption = None,
    polygons: PolygonsOption = None,
    radius: RadiusOption = None,
    box: BoxOption = None,
    enclosed: EnclosedOption = None,
) -> None:
    """Compress the distance to a goal in a MAP into a small file, with a proof of its largest error.

    On maps of the plane the distance that is compressed is exact. In volumes it is an estimate, with proven bounds.
    """
    began = time.perf_counter()
    from plr_jax import metrics
    from plr_jax._atomic import write_atomically
    from plr_jax.plr import NumpyPLR
    from plr_jax.plr.leaves import leaf_model

    output = output or Path(f"{Path(map).stem}.plr")
    if leaf != "best":
        leaf_model(leaf)
    require_writable(output, inputs=(map, oracle))
    require_writable(oracle, inputs=(map,))
    if max_bytes is max_leaves is max_depth is None:
        max_bytes = DEFAULT_BYTES
    if is_volume(map):
        others = {"max_depth": max_depth, "oracle": oracle, "threshold": threshold}
        others |= {"drop_specks": drop_specks, "polygons": polygons, "leaf": None if leaf in VOLUME_LEAVES else leaf}
        limits = {"max_bytes": max_bytes, "max_leaves": max_leaves, "tolerance": tolerance, "seed": seed}
        build_volume(NamedVolume(map, goal, resolution, box, enclosed, radius), output, others=others, **limits)
        return
    if box is not None or enclosed is not None:
        raise ValueError(f"--box and --enclosed are for volumes, and {map} is none: leave them out.")
    named = NamedMap(map, goal, resolution, threshold, drop_specks, polygons, radius)
    with saying(f"reading {map}"):
        workspace, goal_point = named.read()
    if goal_point is None:
        raise ValueError(
            f"{map} has no goal of its own, or one for each of several robots: give one with --goal X,Y."
        )
    if named.is_of_pixels():
        say_vertices(workspace)
    with saying("finding what corners see"):
        exact = prepared_oracle(workspace, goal_point, oracle)
    limits = {"max_bytes": max_bytes, "max_leaves": max_leaves, "max_depth": max_depth, "tolerance": tolerance}
    label = str(named.to(goal_point))
    data, built, errors, interrupted = build_file(exact, label, leaf, leaf_bounds, seed=seed, **limits)
    leaves, name = built.cells, built.leaf.name
    write_atomically(output, data)
    if interrupted:
        typer.echo(f"Interrupted: {output} holds the {len(leaves):,} leaves built so far.", err=True)
        raise typer.Exit(INTERRUPTED_EXIT)
    seconds = time.perf_counter() - began
    # A seed of its own, so that the error is not measured where the planes were fitted.
    with saying("measuring the error"):
        report = metrics.error_map(NumpyPLR(data), exact, workspace.sample_free(_ERROR_POINTS, seed + 1))
    depth = leaves.depth.sum(axis=1).max()
    typer.echo(f"wrote   {output}: {len(data):,} bytes; {len(leaves):,} leaves, depth {depth}")
    others = ", ".join(f"{other} {error:.3g}" for other, error in errors.items() if other != name)
    proven = f"{name}: no error above {errors[name]:.3g}, proven"
    typer.echo(f"leaf    {proven} ({others})" if others else f"leaf    {proven}")
    typer.echo(f"error   max {report.max:.3g}, mean {report.mean:.3g} over {report.num_points:,} random free points")
    typer.echo(
        f"        mean is {100 * report.mean / report.max_distance:.2g} % of the largest distance, "
        f"{report.max_distance:.4g}"
    )
    if report.num_unreachable:
        typer.echo(f"        {report.num_unreachable:,} of the points cannot reach the goal")
    if report.num_unanswered:
        typer.echo(f"        {report.num_unanswered:,} reachable points got no answer")
    typer.echo(f"time    {seconds:.1f} s to build, {time.perf_counter() - began:.1f} s in all")


@command(
    "plr-jax query maze.plr points.csv",
    "plr-jax query maze.plr points.csv --bounds",
    "echo 0.93,0.95 | plr-jax query maze.plr",
    "echo 0.93,0.95,0.1,0.1 | plr-jax query maze.pairs",
)
def query(
    file: FileArgument,
    points: Annotated[
        str,
        typer.Argument(
            metavar="[POINTS.csv | -]", help="Points, one x,y a line; of pairs both ends, x,y,x,y; - is stdin."
        ),
    ] = "-",
    gradient: Annotated[
        bool, typer.Option("--gradient", help="Print distance,dx,dy: the gradient beside the distance.")
    ] = False,
    bounds: Annotated[
        bool, typer.Option("--bounds", help="Print distance,lower,upper: proven bounds beside the distance.")
    ] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Stop at the first row that is no point.")] = False,
) -> None:
    """Print the distance of each point, one a line: inf outside the domain, nan for nan and for what is no point.

    Rows that are none are told on standard error. A first line of names is taken as a header. Tables of any length
    are answered in little memory.
    """
    from plr_jax.plr import NumpyPLR, load_numpy

    require_standard_output()
    plr = _PairsOfRows(loaded(file)) if (is_of_pairs := file_holds_pairs(file)) else load_numpy(file)
    columns: list[Callable[[np.ndarray], Any]] = [plr]
    if gradient and is_of_pairs:
        raise ValueError(f"--gradient is for PLRs, and {file} holds pairs.")
    if gradient:
        columns.append(_gradients(file))
    if bounds and isinstance(plr, NumpyPLR) and plr.max_error is None:
        raise ValueError(f"Nothing is proven of {file}: files that plr-jax build writes have a proof.")
    if bounds:
        columns.append(lambda x: np.column_stack(plr.bounds(x)))
    name, table = open_table(points)
    with table:
        chunks = PointTable(name, plr.dim, strict).chunks(table)
        print_answers(np.column_stack([column(x) for column in columns]) for x in chunks)


@dataclass(frozen=True)
class _PairsOfRows:
    """Pairs that answer rows of both ends side by side, compiled for few sizes."""

    pairs: "PairPLR | GridPairs"
    dim = 4

    def __call__(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(self.pairs(*self._ends(x)))[: len(x)]

    def bounds(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(np.asarray(bound)[: len(x)] for bound in self.pairs.bounds(*self._ends(x)))

    def _ends(self, x: np.ndarray) -> list[np.ndarray]:
        from plr_jax._arrays import padded, padded_size

        return np.split(padded(x, padded_size(len(x))), 2, axis=1)


def _gradients(file: Path) -> Callable[[np.ndarray], np.ndarray]:
    """The gradients at points, NaN for NaN, which JAX differentiates; compiled for few sizes."""
    import jax

    from plr_jax._arrays import padded, padded_size
    from plr_jax._io import load

    gradients = jax.jit(jax.vmap(jax.grad(load(file))))

    def answers(x: np.ndarray) -> np.ndarray:
        found = np.asarray(gradients(padded(x, padded_size(len(x)))))[: len(x)]
        return np.where(np.isnan(x).any(axis=1, keepdims=True), np.nan, found)

    return answers


@command("plr-jax info maze.plr", "plr-jax info maze.plr --json")
def info(
    file: FileArgument, json: Annotated[bool, typer.Option("--json", help="As an object of JSON.")] = False
) -> None:
    """Say what is in a file."""
    from plr_jax._io import load

    facts = {"file": str(file), **facts_of(load(file))}
    if json:
        typer.echo(dumps(facts, indent=2))
    else:
        typer.echo("\n".join(f"{name:11}{printable(told)}" for name, told in lines_of(facts)))


class Picture(StrEnum):
    """What ``plr-jax plot`` draws."""

    distance = "distance"
    cells = "cells"
    surface = "surface"
    error = "error"


@command(
    "plr-jax plot maze.plr -o maze.png",
    "plr-jax plot maze.plr --kind error -o error.png",
    "plr-jax plot maze.pairs --goal 0.1,0.1 -o maze.png",
)
def plot(
    file: FileArgument,
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="The picture to write: .png (also where it has no ending), .pdf or .svg."
        ),
    ],
    map: Annotated[
        str | None,
        typer.Option(
            "--map", metavar="MAP", help="Draw this map's obstacles.", show_default="what FILE was built of"
        ),
    ] = None,
    goal: GoalOfPairsOption = None,
    resolution: ResolutionOption = None,
    threshold: ThresholdOption = None,
    drop_specks: DropSpecksOption = None,
    polygons: PolygonsOption = None,
    radius: RadiusOption = None,
    kind: Annotated[
        Picture,
        typer.Option(help="Colors and contours; the partition; a surface; the error (needs the map)."),
    ] = Picture.distance,
) -> None:
    """Draw a file: of pairs, the distance to the goal."""
    from plr_jax.plr import PLR

    output = output if output.suffix else output.with_name(f"{output.name}.png")
    require_writable(output, PICTURES, inputs=(file, map))
    held = loaded(file)
    is_of_pairs = not isinstance(held, PLR)
    plr = goal_of_pairs(held, file, goal) if is_of_pairs else held
    if plr.domain.dim != 2:
        raise ValueError(
            f"{file} has {plr.domain.dim} axes, of which no plane is chosen here: see plr_jax.plot.slices."
        )
    if not isinstance(plr, PLR) and kind is not Picture.distance:
        raise ValueError(f"{file} holds pairs of cells of a grid: of these only the distance is drawn.")
    reading = {
        "resolution": resolution,
        "threshold": threshold,
        "drop_specks": drop_specks,
        "polygons": polygons,
        "radius": radius,
    }
    is_needed, of_map = kind is Picture.error, None if is_of_pairs else goal
    workspace, goal_point = read_map_of_file(file, held, map, goal=of_map, is_needed=is_needed, **reading)
    if is_of_pairs:
        goal_point = parse_goal(str(goal))
    from plr_jax import metrics
    from plr_jax import plot as draw

    match kind:
        case Picture.distance:
            ax = draw.plot_contours(plr, workspace=workspace, goal=goal_point)
        case Picture.cells:
            ax = draw.plot_cells(plr, workspace=workspace)
        case Picture.surface:
            ax = draw.plot_surface(plr, workspace=workspace)
        case Picture.error:
            if workspace is None or goal_point is None:
                raise ValueError(f"{file} does not say of which map and goal it is: give --map, and --goal X,Y.")
            from plr_jax.oracles import VisibilityGraph

            errors = metrics.error_grid(plr, VisibilityGraph(workspace, goal_point), workspace)
            ax = draw.plot_error(errors, workspace)
    draw.save(ax, output)
    typer.echo(f"wrote {output}")


@command("plr-jax demo --output pictures")
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the files.")] = Path("plr_jax_demo"),
) -> None:
    """Compress a maze, measure the result beside the exact distance, and draw it; plan for four robots."""
    from plr_jax.cli import _demo

    _demo.run(output)
