"""An example of trajectory optimization: shorten the paths of a team of discs by gradient descent.

All way points move at once. The loss is the length of the path, with penalties where discs come closer to walls or
to each other than a margin. Clearances come from ``workspace.clearance``, which JAX differentiates. ``validate``
decides: the shortest valid path of all checks is kept, so the result is never longer than the path that was given.
"""

import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float
from matplotlib.figure import Figure

from experiments._planning import PLR, PLR_BYTES, SCENES, SMOKE_BYTES, lower_bound, solve
from experiments._runner import run
from plr_jax import Problem, plot, validate

SHOWN = "four rooms 4"
DISCS = [name for name in SCENES if name != "tangle"]
NUM_STEPS, CHECK_EVERY, RATE = 3_000, 100, 2e-3
WEIGHT, MARGIN = 200.0, 2e-3  # of the penalties; clearance to keep, in workspace units
WAY_POINTS, SHARES = 120, np.linspace(0, 1, 4, endpoint=False)  # of a path; where clearances are taken in each step

TeamPath = Float[np.ndarray, "steps robots 2"]


def optimize(problem: Problem, path: TeamPath, num_steps: int = NUM_STEPS) -> TeamPath:
    """Return the shortest valid path that gradient descent finds from a valid path of discs."""
    # 1. Way points at equal times, besides those of the path.
    length = np.append(0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=2).max(axis=1)))
    times = np.union1d(length, np.linspace(0, length[-1], WAY_POINTS))
    fine = np.stack([[np.interp(times, length, track) for track in robot.T] for robot in path.swapaxes(0, 1)])
    path = np.ascontiguousarray(fine.transpose(2, 0, 1))
    radii = jnp.array([robot.circumscribed_radius for robot in problem.robots])
    first, second = np.triu_indices(len(radii), 1)
    workspace = problem.workspace

    # 2. Length, and squared shortfalls of clearance within each step.
    def loss(inner: Float[Array, "inner robots 2"]) -> Float[Array, ""]:
        q = jnp.concatenate([jnp.asarray(path[:1]), inner, jnp.asarray(path[-1:])])
        move = q[1:] - q[:-1]
        along = q[:-1, None] + SHARES[:, None, None] * move[:, None]
        to_walls = workspace.clearance(along) - radii - MARGIN
        apart = jnp.linalg.norm(along[:, :, first] - along[:, :, second] + 1e-9, axis=-1)
        to_others = apart - radii[first] - radii[second] - MARGIN
        penalty = (jnp.minimum(to_walls, 0) ** 2).sum() + (jnp.minimum(to_others, 0) ** 2).sum()
        return jnp.sqrt((move**2).sum(axis=-1) + 1e-12).sum() + WEIGHT * penalty

    # 3. Descend; look at the path now and then.
    optimizer = optax.adam(optax.cosine_decay_schedule(RATE, num_steps))

    @jax.jit
    def descended(inner: Any, state: Any) -> tuple[Any, Any]:
        def step(_: Any, carry: tuple[Any, Any]) -> tuple[Any, Any]:
            update, state = optimizer.update(jax.grad(loss)(carry[0]), carry[1])
            return optax.apply_updates(carry[0], update), state

        return jax.lax.fori_loop(0, CHECK_EVERY, step, (inner, state))

    inner = jnp.asarray(path[1:-1])
    state, best, least = optimizer.init(inner), path, validate(problem, path).cost
    for _ in range(-(-num_steps // CHECK_EVERY)):
        inner, state = descended(inner, state)
        found = np.concatenate([path[:1], np.asarray(inner, float), path[-1:]])
        report = validate(problem, found)
        if report.valid and report.cost < least:
            best, least = found, report.cost
    return best


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for name in [SHOWN] if smoke else DISCS:
        problem, bound = SCENES[name](), lower_bound(SCENES[name]())
        solution, path = solve(problem, PLR, SMOKE_BYTES if smoke else PLR_BYTES)
        path[[0, -1]] = problem.starts, problem.goals
        began = time.perf_counter()
        after = optimize(problem, path, CHECK_EVERY if smoke else NUM_STEPS)
        row = {"scene": name, "seconds": time.perf_counter() - began}
        costs = {"before": validate(problem, path).cost / bound, "after": validate(problem, after).cost / bound}
        row |= {"cost_over_bound": costs, "seconds_plan": sum(solution.stats.seconds.values())}
        row |= {"valid": validate(problem, after).valid}
        rows.append(row | ({"before": path.tolist(), "after": after.tolist()} if name == SHOWN else {}))
    return {"rows": rows}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    figure = Figure(figsize=(10.4, 5.6), layout="constrained", facecolor="white")
    row = next(row for row in results["rows"] if row["scene"] == SHOWN)
    axes = figure.subplots(1, 2)
    for ax, name in zip(axes, ("before", "after"), strict=True):
        plot.plot_path(SCENES[SHOWN](), np.array(row[name]), ax)
        ax.set_title(f"{name}: {row['cost_over_bound'][name]:.4f} of the bound", fontsize=10)
    plot.save(axes[0], output / "trajectory.png")
    return [output / "trajectory.png"]


if __name__ == "__main__":
    run("trajectory", __doc__, compute, draw)
