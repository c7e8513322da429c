"""The command ``plr-jax plan``: from a scene to a checked path for all its robots."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from plr_jax.cli import INTERRUPTED_EXIT
from plr_jax.cli._app import command, fail
from plr_jax.cli._inputs import DEFAULT_BYTES, PICTURES, TEAM_SCENES, Heuristic, read_problem, require_writable

if TYPE_CHECKING:
    from plr_jax._problem import Problem
    from plr_jax.planners import Solution


class _Default:
    """What ``BLOptions`` holds where nothing is given. It is imported only where it is asked for."""

    def __init__(self, field: str):
        self.field = field

    def __call__(self) -> Any:
        from plr_jax.planners import BLOptions

        return getattr(BLOptions, self.field)

    def __str__(self) -> str:  # in the help
        return f"{self():g}"


def _of_planner(field: str, help: str) -> Any:
    return typer.Option(help=help, default_factory=_Default(field))


@command(
    "plr-jax plan four_rooms --robots 4 --animation four_rooms.gif",
    "plr-jax plan tangle --heuristic oracle --output path.json",
    "plr-jax plan four_rooms --robots 3 --cost-factor 1.02 --time-limit 10",
)
def plan(
    scene: Annotated[
        str,
        typer.Argument(
            metavar="SCENE",
            help=f"A scene ({', '.join(TEAM_SCENES)}), a scene file (.json), or a db-CBS problem (.yaml).",
            show_default=False,
        ),
    ],
    *,
    robots: Annotated[
        int | None,
        typer.Option(
            help="Number of robots: 2, 3, 4 or 8 in four_rooms, 2 or 3 in cross.",
            show_default="4 in four_rooms, 2 in cross",
        ),
    ] = None,
    heuristic: Annotated[
        Heuristic,
        typer.Option(
            help="Cost-to-go: that along each robot's lattice, nothing, straight lines, PLRs of point robots as in "
            "the paper, PLRs of obstacles grown by each robot's radius, or the exact distance that these compress."
        ),
    ] = Heuristic.lattice,
    plr_bytes: Annotated[int, typer.Option(help="Largest size of each PLR.")] = DEFAULT_BYTES,
    seed: Annotated[int, typer.Option(help="Seed of the PLRs' sample pattern.")] = 0,
    step: Annotated[
        float | None,
        typer.Option(help="Side of a lattice's cells, in workspace units.", show_default="chosen, then refined"),
    ] = None,
    cell_size: Annotated[
        float | None,
        typer.Option(
            help="Side of the cells that joint configurations claim, in workspace units.",
            show_default="each its own",
        ),
    ] = None,
    weight: Annotated[
        float | None,
        typer.Option(
            help="Factor of the heuristic; the larger, the greedier.", show_default="by the number of robots"
        ),
    ] = None,
    batch: Annotated[int, _of_planner("batch", "Most nodes expanded at once.")],
    branching: Annotated[int, _of_planner("branching", "Children that a node adds at a time.")],
    width: Annotated[int, _of_planner("width", "Joint children held while a product is assembled.")],
    cost_factor: Annotated[
        float,
        _of_planner(
            "cost_factor", "Search on while the cost is above this multiple of the lower bound, until a limit."
        ),
    ],
    time_limit: Annotated[float, _of_planner("time_limit", "Seconds of planning.")],
    max_expansions: Annotated[float, _of_planner("max_expansions", "Most expansions.")],
    max_memory: Annotated[float, _of_planner("max_memory", "Most bytes of lattices and nodes.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help='Write the solution as JSON: "path" is (steps, robots, dof). Solution.load reads it.',
        ),
    ] = None,
    animation: Annotated[Path | None, typer.Option(help="Write the path in motion: .gif or .html.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the path: .png, .pdf or .svg.")] = None,
) -> None:
    """Plan for all robots of a SCENE at once, check the path, and report.

    Exit code 1: no path was found.
    """
    began = time.perf_counter()
    require_writable(output, (".json",), inputs=(scene,))
    require_writable(animation, (".gif", ".html"))
    require_writable(picture, PICTURES)
    from plr_jax.cli import _planning
    from plr_jax.planners import BLOptions, Status
    from plr_jax.planners._solution import save_solution

    options = BLOptions(
        step=step,
        cell_size=cell_size,
        heuristic_weight=weight,
        batch=batch,
        branching=branching,
        width=width,
        cost_factor=cost_factor,
        time_limit=time_limit,
        max_expansions=max_expansions,
        max_memory=max_memory,
    )
    problem = read_problem(scene, robots)
    phases = _planning.Phases(began)
    phases.end("loading")
    typer.echo(scene)
    solution, report = _planning.solve(problem, heuristic, options, plr_bytes, seed, phases)
    if report is not None and report.valid:
        if output is not None:
            save_solution(solution, output, clearance=report.clearance)
        _draw(problem, solution, animation, picture)
        for file in (output, animation, picture):
            if file is not None:
                typer.echo(f"  wrote      {file}")
        phases.end("writing")
    _planning.say_seconds(phases, solution)
    if report is not None and not report.valid:
        fail(f"The path found is not valid, and was not written: {report.message}", code=1)
    if solution.status is Status.INTERRUPTED:
        typer.echo(f"Interrupted: {'the best path so far' if solution.solved else 'no path yet'}.", err=True)
        raise typer.Exit(INTERRUPTED_EXIT)
    if not solution.solved:
        fail(f"No path: {solution.status}.", code=1)


def _draw(problem: "Problem", solution: "Solution", animation: Path | None, picture: Path | None) -> None:
    if animation is None and picture is None:
        return
    from plr_jax import plot

    if animation is not None:
        plot.animate(problem, solution.path).save(animation)
    if picture is not None:
        plot.save(plot.plot_path(problem, solution.path), picture)
