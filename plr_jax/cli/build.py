"""The command ``plr-jax build``: compress the distance to a goal in a map, with proven error bounds."""

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from jaxtyping import Bool

import plr_jax
from plr_jax.cli import INTERRUPTED_EXIT
from plr_jax.cli.app import command, finish_or_stop, progress
from plr_jax.cli.inputs import (
    DEFAULT_BYTES,
    DropSpecksOption,
    GoalOption,
    MapArgument,
    NamedMap,
    PolygonsOption,
    RadiusOption,
    ResolutionOption,
    ThresholdOption,
    choices,
    joined_goals,
    oracle_of,
    require_writable,
)

if TYPE_CHECKING:
    from plr_jax import PLR, DistanceFn
    from plr_jax.geometry.workspace import Workspace

_LEAVES = ("best", "plane", "continuous", "smooth", "cone")
_PROVEN_TOLERANCE = ("plane", "cone")  # leaves of which --tolerance limits the proven error, not a sampled one
_ROUNDED = 1.01  # files round proven errors up, by less than this factor
_ERROR_POINTS = 20_000
_SPECK = 4  # pixels; smaller obstacles and free components are reported as specks


@command(
    "plr-jax build maze -o maze.plr --max-bytes 2048",
    "plr-jax build floor_plan --leaf cone --max-bytes 1024 --leaf-bounds",
    "plr-jax build scan.png --goal 10.5,30 --resolution 0.05 --drop-specks 4 --radius 0.3",
    "plr-jax build area.wkt --goal 1,2 --goal 30,4 --leaf cone",
)
def build(
    map: MapArgument,
    goal: GoalOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The file to write.", show_default="MAP's name with .plr")
    ] = None,
    max_bytes: Annotated[
        int | None,
        typer.Option(help="Largest size of the file.", show_default=f"{DEFAULT_BYTES} if no limit is given"),
    ] = None,
    max_leaves: Annotated[int | None, typer.Option(help="Largest number of cells.", show_default=False)] = None,
    max_depth: Annotated[int | None, typer.Option(help="Largest depth of the tree.", show_default=False)] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Stop when the error, in workspace units, is below this: the proven error for planes and cones, the "
            "sampled error for other leaves.",
            show_default=False,
        ),
    ] = None,
    leaf: Annotated[
        str,
        typer.Option(
            help="Function in each cell: 'plane'; 'continuous', without jumps between connected cells; 'smooth', "
            "without jumps of the gradient either; 'cone', the length of paths by way of one corner. 'best' builds "
            "only cones if --max-bytes is the only limit of size and has ample room for all corners. Otherwise it "
            "builds all these kinds, without cones if the corners need far more room, and keeps the smallest proven "
            "error.",
            **choices(_LEAVES),
        ),
    ] = "best",
    leaf_bounds: Annotated[
        bool,
        typer.Option(
            "--leaf-bounds",
            help="Store proven bounds for every cell, 2 bytes each, instead of one bound for all: certified='leaves' "
            "in Python.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of the sample pattern.")] = 0,
    resolution: ResolutionOption = None,
    threshold: ThresholdOption = None,
    drop_specks: DropSpecksOption = None,
    polygons: PolygonsOption = None,
    radius: RadiusOption = None,
) -> None:
    """Compress the exact distance to the nearest goal in a MAP into a small file with a proven error bound.

    In pictures, y points up, from the lower edge of the picture.
    """
    from plr_jax.plr.container import MOST_LABEL_BYTES, frame_size
    from plr_jax.plr.growth import BudgetTooSmall
    from plr_jax.scenes._pictures import PICTURE_ENDINGS

    began = time.perf_counter()
    output = output or Path(f"{Path(map).stem}.plr")
    require_writable(output, inputs=(map,))
    if max_bytes is max_leaves is max_depth is None:
        max_bytes = DEFAULT_BYTES

    # 1. Read the map, and prepare its exact oracle.
    named = NamedMap(map, joined_goals(goal), resolution, threshold, drop_specks, polygons, radius)
    with progress(f"reading {map}"):
        workspace, goals = named.read()
    if goals is None:
        raise ValueError(f"expected a goal, but {map} has none, or one for each of several robots: give --goal X,Y.")
    label = str(replace(named, goal=";".join(f"{x!r},{y!r}" for x, y in goals.tolist())))
    if len(label.encode()) > MOST_LABEL_BYTES:
        raise ValueError(
            f"The file's label holds MAP, its options and goals in {MOST_LABEL_BYTES:,} bytes, got "
            f"{len(label.encode()):,}, of {len(goals)} goals: give fewer goals, or fewer digits."
        )
    if (free := named.free_pixels()) is not None:
        width, height = workspace.bounds.width
        is_in_pixels = Path(map).suffix.lower() in PICTURE_ENDINGS and resolution is None
        size = f"{width:g} x {height:g} {'pixels' if is_in_pixels else 'workspace units'}"
        specks = _specks(free, drop_specks or 0)
        typer.echo(f"map     {len(workspace.boundary.vertices):,} vertices, {size}{specks}")
    with progress("computing visibility between corners"):
        oracle = oracle_of(workspace, goals)

    # 2. Construct the PLR, with room for its label in the file.
    label_bytes = frame_size(workspace.bounds, label=label) - frame_size(workspace.bounds)
    try:
        plr, interrupted = finish_or_stop(
            plr_jax.construct,
            oracle,
            workspace.bounds,
            leaf=leaf,
            max_bytes=None if max_bytes is None else max(1, max_bytes - label_bytes),
            max_leaves=max_leaves,
            max_depth=max_depth,
            tolerance=tolerance,
            certified="leaves" if leaf_bounds else True,
            seed=seed,
        )
    except BudgetTooSmall as error:
        raise ValueError(
            f"--max-bytes {max_bytes} is too small: one leaf takes {error.num_bytes} bytes, the label {label_bytes}; "
            f"allow at least {error.num_bytes + label_bytes}."
        ) from error
    seconds = time.perf_counter() - began
    plr_jax.save(plr := plr.with_label(label), output)
    if interrupted:
        typer.echo(f"Interrupted: {output} holds the {plr.num_leaves:,} leaves built so far.", err=True)
        raise typer.Exit(INTERRUPTED_EXIT)

    # 3. Report the error at points of another seed than the samples to which leaves were fitted.
    typer.echo(f"wrote   {output}: {plr.num_bytes:,} bytes; {plr.num_leaves:,} leaves, depth {plr.depth}")
    _print_errors(plr, oracle, workspace, seed + 1, tolerance)
    if radius:
        # A total error needs a second oracle, among polygons around the grown obstacles, which may close passages.
        typer.echo("        proven for polygons inside the grown obstacles; the disc's own distances are not smaller")
    typer.echo(f"time    {seconds:.1f} s to build, {time.perf_counter() - began:.1f} s in all")


def _specks(free: Bool[np.ndarray, "rows columns"], num_dropped: int) -> str:
    from plr_jax.geometry.masks import without_specks

    _, count = without_specks(without_specks(free, num_dropped)[0], _SPECK)
    plural = "s" * (count > 1)
    return (
        f", {count:,} speck{plural} of at most {_SPECK} pixels (--drop-specks {_SPECK} drops them)" if count else ""
    )


def _print_errors(
    plr: "PLR", oracle: "DistanceFn", workspace: "Workspace", seed: int, tolerance: float | None
) -> None:
    points, largest = workspace.sample_free(_ERROR_POINTS, seed), plr.max_error
    assert largest is not None
    with progress("measuring the error"):
        report = plr_jax.metrics.error_map(plr.numpy(), oracle, points)
    typer.echo(f"leaf    {plr.leaf.name}: no error above {largest:.3g}, proven")
    if (
        tolerance is not None
        and (largest if plr.leaf.name in _PROVEN_TOLERANCE else report.max) > _ROUNDED * tolerance
    ):
        typer.echo(f"        --tolerance {tolerance:g} was not reached")
    typer.echo(f"error   max {report.max:.3g}, mean {report.mean:.3g} over {report.num_points:,} random free points")
    share = 100 * report.mean / report.max_distance
    typer.echo(f"        mean is {share:.2g} % of the largest distance, {report.max_distance:.4g}")
    if report.num_unreachable:
        typer.echo(f"        {report.num_unreachable:,} of the points cannot reach the goal")
    if report.num_unanswered:
        typer.echo(f"        {report.num_unanswered:,} reachable points got no answer")
