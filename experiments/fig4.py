"""Fig. 4 of the paper: where BL places its samples under PLRs; and, for comparison, under straight lines.

BL searches alone, and the PLRs summarize the distances of points, as in the paper.
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from experiments._planning import PLR_BYTES, POINT_PLR, SCENES, SMOKE_BYTES, STRAIGHT, solve
from experiments._runner import run
from plr_jax import Problem, plot

COLUMNS = ("single door", "cross 3", "four rooms 4")
ROWS = (POINT_PLR, STRAIGHT)
_APART = 0.09  # how far the samples of robots that share a lattice are moved, so that none hides another's
_DOT = 9.0  # square points


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    """The scenes as published; nothing here is random."""
    plr_bytes, columns = (SMOKE_BYTES, COLUMNS[:2]) if smoke else (PLR_BYTES, COLUMNS)

    def samples_of(name: str, heuristic: str) -> list[Any]:
        return np.round(solve(SCENES[name](), heuristic, plr_bytes)[0].samples, 4).tolist()

    samples = {name: {heuristic: samples_of(name, heuristic) for heuristic in ROWS} for name in columns}
    return {"plr_bytes": plr_bytes, "samples": samples}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    figure = Figure(figsize=(11.6, 8.4), layout="constrained", facecolor="white")
    columns = list(results["samples"])
    axes = figure.subplots(len(ROWS), len(columns))
    for row, heuristic in zip(axes, ROWS, strict=True):
        for ax, name in zip(row, columns, strict=True):
            problem, samples = SCENES[name](), np.array(results["samples"][name][heuristic])
            plot.plot_samples(problem, moved_apart(problem, samples), ax)
            ax.collections[-1].set_sizes([_DOT])
            ax.set_title(f"{name}, {heuristic}: {len(samples):,} samples", fontsize=10)
    figure.supxlabel(f"samples of a team's robots are drawn {_APART} apart, so that none hides another's", fontsize=9)
    path = output / "fig4.png"
    plot.save(axes[0, 0], path)
    return [path]


def moved_apart(problem: Problem, samples: Float[np.ndarray, "n robots dof"]) -> Float[np.ndarray, "n robots dof"]:
    """Samples of a team, those of each robot moved a little its own way."""
    num_robots = len(problem.robots)
    angle = 2 * np.pi * np.arange(num_robots) / num_robots
    offset = np.stack([np.cos(angle), np.sin(angle)], axis=1) * (_APART if num_robots > 1 else 0.0)
    return samples + np.pad(offset, ((0, 0), (0, problem.dof - 2)))


if __name__ == "__main__":
    run("fig4", "Samples that BL alone places in three scenes, under PLRs and under straight lines.", compute, draw)
