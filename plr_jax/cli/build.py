"""The command ``plr-jax build``: compress the distance to a goal in a map, with proven error bounds."""

import time
import warnings
from decimal import ROUND_CEILING, Context
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import plr_jax
from plr_jax.cli.app import command, fail_interrupted, warn
from plr_jax.cli.inputs import DEFAULT_BYTES, SCENES, NamedMap, check_output, oracle_of, parse_goals

_ROUNDED = 1.01  # files round proven errors up, by less than this factor
_ERROR_POINTS = 20_000  # random free points at which the error is measured
_SMALL_BYTES = 32_768  # larger files are not for small machines, and take seconds to encode for compact headers
_GOAL_OPTION = typer.Option("--goal", "-g", metavar="X,Y", show_default="the goal of a scene of one robot")


def _kinds_of_leaves() -> list[str]:
    from plr_jax.plr.leaves import leaf_names

    return ["best", *leaf_names()]


def measure_error(plr: Any, oracle: Any, workspace: Any) -> tuple[Any, str]:
    """Return the error of a PLR at random free points, an ``ErrorReport``, and the words in which commands report it.

    The points have another seed than the samples to which leaves are fitted.
    """
    report = plr_jax.metrics.error_map(plr, oracle, workspace.sample_free(_ERROR_POINTS, seed=1))
    return report, f"max {report.max:.3g}, mean {report.mean:.3g} over {report.num_points:,} random free points"


def cost_of(content: Any, compact: bool = False) -> list[str]:
    """Describe in a few lines how many bytes a PLR's C header takes in flash and on the stack of a Cortex-M4."""
    from plr_jax.plr.portable.c import cost_in_c

    num_floors = len(content.floors.lo) if hasattr(content, "floors") else 0
    return cost_in_c(getattr(content, "plane", content).to_bytes(), compact, num_floors)


def _map_option(default: str) -> Any:
    """Return a command-line option for an argument of the function that reads the map.

    An option that the user does not give is None, and is not passed to that function, so that the function's own
    default applies. The text ``default`` describes this default in the help of the option.
    """
    return typer.Option(show_default=default, rich_help_panel="How MAP is read")


@command(
    "plr-jax build maze -o maze.plr --max-bytes 2048",
    "plr-jax build floor_plan --leaf cone --max-bytes 1024 --leaf-bounds",
    "plr-jax build scan.png --goal 10.5,30 --resolution 0.05 --drop-specks 4 --radius 0.3",
    "plr-jax build area.wkt --goal 1,2 --goal 30,4 --leaf cone",
    "plr-jax build building.json --goal 0,1.5,2 --leaf cone",
)
def build(
    map: Annotated[str, typer.Argument(metavar="MAP", autocompletion=lambda: list(SCENES))],
    goal: Annotated[list[str] | None, _GOAL_OPTION] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", show_default="MAP's name with .plr")] = None,
    max_bytes: int = DEFAULT_BYTES,
    tolerance: float | None = None,
    leaf: Annotated[str, typer.Option(autocompletion=_kinds_of_leaves)] = "best",
    leaf_bounds: Annotated[bool, typer.Option("--leaf-bounds")] = False,
    resolution: Annotated[float | None, _map_option("1")] = None,
    threshold: Annotated[float | None, _map_option("0.5")] = None,
    drop_specks: Annotated[int | None, _map_option("0")] = None,
    polygons: Annotated[
        Literal["obstacles", "free"] | None, _map_option("obstacles in GeoJSON, free in .wkt")
    ] = None,
    radius: Annotated[float | None, _map_option("0, a point")] = None,
) -> None:
    """Compress the exact distance to the nearest goal in a MAP into a small file with a proven error bound.

    In pictures, y points up, from the lower edge of the picture.

    Args:
        map: A scene (maze, thin_maze, floor_plan) or a file that plr_jax.scenes.read_workspace reads, such as a
            picture (.png), a map of map_server (.yaml; costs are ignored), or GeoJSON (bounded by its "bbox", or else
            by its polygons). Or a building, as plr_jax.scenes.save_building writes it.
        goal: The goal, in a building FLOOR,X,Y; given several times, the nearest of several, such as exits.
        output: The file to write.
        max_bytes: Largest size of the file.
        tolerance: Stop when the error, in workspace units, is below this: the proven error for planes and cones, the
            sampled error for other leaves.
        leaf: Function in each cell: 'plane'; 'continuous', without jumps between connected cells; 'smooth', without
            jumps of the gradient either; 'cone', the length of paths by way of one corner. 'best' builds only cones
            if --max-bytes is the only limit and has ample room for all corners. Otherwise it builds all these kinds,
            without cones if the corners need far more room, and keeps the smallest proven error.
        leaf_bounds: Store proven bounds for every cell, 2 bytes each, not one bound for all.
        resolution: Side of a pixel of a picture, in workspace units.
        threshold: Lightness above which a pixel is free, from 0 (black) to 1 (white).
        drop_specks: Drop obstacles and free components of at most this many pixels.
        polygons: Whether polygons are obstacles or free space.
        radius: Radius of a disc robot, in workspace units; distances are for its center. Error bounds are proven for
            the grown obstacles, whose round corners are polygons; outlines of pictures may be off by half a pixel.
    """
    from plr_jax.plr.container import MOST_LABEL_BYTES, frame_size
    from plr_jax.plr.growth import BudgetTooSmall

    began = time.perf_counter()
    output = output or Path(f"{Path(map).stem}.plr")
    check_output(output, inputs=(map,))

    # 1. Read the map, and prepare its exact oracle.
    options = {"resolution": resolution, "threshold": threshold, "drop_specks": drop_specks, "polygons": polygons}
    given = {key: value for key, value in {**options, "radius": radius}.items() if value is not None}
    of_building = None
    if map not in SCENES and plr_jax.scenes.is_building(map):
        if given:
            raise ValueError(f"{map} is a building, which is read without options, got {', '.join(given)}.")
        numbers = parse_goals(goal or [], "FLOOR,X,Y")
        places = [(int(floor) if floor.is_integer() else float(floor), (x, y)) for floor, x, y in numbers]
        of_building = plr_jax.scenes.read_building(map).oracle(places)
        workspace, oracle, label = of_building.building.plane, of_building.paths, map
    else:
        workspace, goals = NamedMap(map, parse_goals(goal) if goal else None, given).read()
        if goals is None:
            reason = f"{map} has none, or one for each of several robots"
            raise ValueError(f"expected a goal, but {reason}: give --goal X,Y.")
        oracle, label = oracle_of(workspace, goals), NamedMap(map, goals, given).label
    if (length := len(label.encode())) > MOST_LABEL_BYTES:
        stored = f"MAP, its options and its {len(goal or [])} goals"
        raise ValueError(f"The file has {MOST_LABEL_BYTES:,} bytes for {stored}, got {length:,}: give fewer goals.")
    width, height = workspace.bounds.width
    typer.echo(f"map     {len(workspace.boundary.vertices):,} vertices, {width:g} x {height:g}")

    # 2. Construct the PLR, with room for its label and the floors in the file. After Ctrl-C, it holds the leaves
    #    built so far.
    other_bytes = frame_size(workspace.bounds, label=label) - frame_size(workspace.bounds)
    other_bytes += 0 if of_building is None else len(of_building.floors.to_bytes())
    limits = {"max_bytes": max(1, max_bytes - other_bytes), "tolerance": tolerance}
    certified = "leaves" if leaf_bounds else True
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", plr_jax.ConstructionInterrupted)
            plr = plr_jax.construct(oracle, workspace.bounds, leaf=leaf, certified=certified, **limits)
    except BudgetTooSmall as error:
        needed = error.num_bytes + other_bytes
        raise ValueError(f"--max-bytes {max_bytes} is too small: allow at least {needed}.") from error
    seconds = time.perf_counter() - began
    plr = plr.with_label(label)
    content = plr if of_building is None else plr_jax.buildings.BuildingPLR(of_building.floors, plr)
    plr_jax.save(content, output)
    if any(issubclass(warning.category, plr_jax.ConstructionInterrupted) for warning in caught):
        fail_interrupted(f"Interrupted: {output} holds the {plr.num_leaves:,} leaves built so far.")
    for warning in caught:
        warn(str(warning.message))

    # 3. Report the proven error, rounded up, and the measured one.
    typer.echo(f"wrote   {output}: {content.num_bytes:,} bytes; {plr.num_leaves:,} leaves, depth {plr.depth}")
    report, measured = measure_error(plr.numpy(), oracle, workspace)
    proven = plr.max_error
    assert proven is not None
    rounded = float(Context(prec=3, rounding=ROUND_CEILING).create_decimal_from_float(proven))
    typer.echo(f"leaf    {plr.leaf.name}: no error above {rounded:g}, proven")
    limited = proven if plr.leaf.splits_by_proven_error else report.max
    if tolerance is not None and limited > _ROUNDED * tolerance:
        typer.echo(f"        --tolerance {tolerance:g} was not reached")
    typer.echo(f"error   {measured}")
    share = 100 * report.mean / report.max_distance
    typer.echo(f"        mean is {share:.2g} % of the largest distance, {report.max_distance:.4g}")
    if radius:
        # A total error needs a second oracle, among polygons around the grown obstacles, which may close passages.
        typer.echo("        proven for polygons inside the grown obstacles; the disc's own distances are not smaller")
    typer.echo("in C    " + "\n        ".join(cost_of(content)))
    if content.num_bytes <= _SMALL_BYTES:
        typer.echo(f"compact {cost_of(content, compact=True)[0]}")
    typer.echo(f"time    {seconds:.1f} s to build, {time.perf_counter() - began:.1f} s in all")
