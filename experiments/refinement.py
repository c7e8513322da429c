"""Refinement: what each loss and penalty gains over cell-by-cell least squares, and what it costs.

The partition is that of ``construct`` under a budget of bytes; only its planes move. "as constructed" has the
least-squares planes of construction's own samples, "least squares" those of the training points (the squared loss
alone is that, cell by cell). Every row is measured at points that no row has seen. No row is held to the budget: the
bytes are those that its planes need in the bits of the constructed ones.
"""

import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from experiments._runner import run
from plr_jax import PLR, VisibilityGraph, Workspace, construct, scenes
from plr_jax.plr import Faces, eikonal, jumps, quantile, refine, sample_faces

TRAINING_SEED, TEST_SEED = 3_000, 4_000
SHARES = (0.5, 0.05, 0.01)
EIKONAL_WEIGHT = 1e-4  # a slope off by 1 counts like an error of 0.01
JUMP_WEIGHTS = (0.1, 1.0)
_MARKERS = "os^Dv<>ph*XP"


def configurations(faces: Faces) -> dict[str, dict[str, Any]]:
    """Arguments of ``refine`` by the name of a row."""
    return {
        "least squares": {},
        **{f"quantile {share:g}": {"loss": quantile(share)} for share in SHARES},
        f"eikonal {EIKONAL_WEIGHT:g}": {"penalties": [eikonal(EIKONAL_WEIGHT)]},
        **{f"jumps {weight:g}": {"penalties": [jumps(faces, weight)]} for weight in JUMP_WEIGHTS},
    }


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    budgets = [256] if smoke else [2_048, 6_000]
    num_points, num_test = (1_000, 1_000) if smoke else (100_000, 500_000)
    rows = []
    for name, problem in {"maze": scenes.maze(), **({} if smoke else {"thin_maze": scenes.thin_maze()})}.items():
        exact = VisibilityGraph(problem.workspace, problem.goals[0])
        x, test = (
            problem.workspace.sample_free(n, first_seed + seed)
            for n, first_seed in ((num_points, TRAINING_SEED), (num_test, TEST_SEED))
        )
        distance, expected = exact(x), exact(test)
        for budget in budgets:
            rows += [
                {"scene": name, "budget": budget, **row}
                for row in _measure_scene(problem.workspace, exact, budget, (x, distance), (test, expected), seed)
            ]
    return {"training_points": num_points, "test_points": num_test, "shares": list(SHARES), "rows": rows}


def _measure_scene(
    workspace: Workspace, exact: VisibilityGraph, budget: int, training: tuple, test: tuple, seed: int
) -> list[dict[str, Any]]:
    plr = construct(exact, workspace.bounds, max_bytes=budget, seed=seed)
    faces = sample_faces(plr, exact, seed=seed)
    rows = [{"planes": "as constructed", "seconds": 0.0, **measure(plr, faces, *test)}]
    # What a one-sided loss must beat: all values lowered alike, until the share is the same.
    error = np.asarray(plr(training[0]), np.float64) - training[1]
    for share in SHARES:
        lowered = measure(plr, faces, *test, lowered_by=float(np.quantile(error, 1 - share)))
        rows.append({"planes": f"lowered {share:g}", "asked_over": share, "seconds": 0.0, **lowered})
    for name, arguments in configurations(faces).items():
        # All points that are given may be fitted to: the errors here are those at the test points. The first call
        # compiles.
        seconds = []
        for _ in range(2):
            began = time.perf_counter()
            refined, report = refine(plr, *training, held_out=0, seed=seed, **arguments)
            seconds.append(time.perf_counter() - began)
        measured = measure(refined, faces, *test)
        asked = getattr(arguments.get("loss"), "share", None)
        rows.append(
            {"planes": name, "asked_over": asked, "seconds": seconds[1], "seconds_first": seconds[0], **measured}
            | {"kept_leaves": report.num_kept, "leaves": plr.num_leaves, "shift": report.shift}
        )
    return rows


def measure(
    plr: PLR,
    faces: Faces,
    x: Float[np.ndarray, "n 2"],
    distance: Float[np.ndarray, "n"],
    lowered_by: float = 0.0,
) -> dict[str, Any]:
    """Errors at points, slopes there, and jumps across free faces."""
    error = np.asarray(plr(x), np.float64) - lowered_by - distance
    slope = np.asarray(jax.jit(jax.vmap(jax.grad(plr)))(x), np.float64)
    return {
        "bytes": plr.num_bytes,
        "mean": float(np.abs(error).mean()),
        "max": float(np.abs(error).max()),
        "over": float(np.mean(error > 0)),
        "max_over": float(error.max()),
        "eikonal_rms": _rms(np.linalg.norm(slope, axis=1) - 1),
        "jump_rms": _rms(faces.jumps(plr)),
    }


def _rms(values: Float[np.ndarray, "n"]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """For every partition the mean error of each way to fit its planes against the share of over-estimates."""
    panels: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for row in results["rows"]:
        panels.setdefault((row["scene"], row["budget"]), []).append(row)
    figure = Figure(figsize=(1.5 + 3.4 * len(panels), 3.2), dpi=110, layout="constrained")
    for ax, ((scene, budget), rows) in zip(
        figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True
    ):
        for number, row in enumerate(rows):
            ax.plot(row["over"], row["mean"], _MARKERS[number % len(_MARKERS)], label=row["planes"], fillstyle="none")
        ax.set(title=f"{scene}, {budget:,} bytes", xlabel="share of over-estimates", xlim=(-0.03, 1), yscale="log")
        ax.set_ylabel("mean error $|L - V|$")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside right center", fontsize=8, frameon=False)
    path = output / "refinement.png"
    figure.savefig(path)
    return [path]


if __name__ == "__main__":
    run("refinement", "What refinement gains over cell-by-cell least squares, and what it costs.", compute, draw)
