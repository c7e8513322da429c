"""Fig. 3 of the paper: the paths of three discs in the cross, in two halves, and of two rectangles in the tangle."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from experiments._planning import PLR_BYTES, SCENES, SMOKE_BYTES, solved_scene
from experiments._runner import run
from plr_jax import plot

PANELS = (
    ("cross 3", 0.0, 0.5, "three discs in the cross, first half"),
    ("cross 3", 0.5, 1.0, "second half"),
    ("tangle", 0.0, 1.0, "two rectangles change places in the hallway"),
)


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    """Both scenes as published; nothing here is random."""
    names = dict.fromkeys(name for name, *_ in PANELS)
    plr_bytes = SMOKE_BYTES if smoke else PLR_BYTES
    return {"plr_bytes": plr_bytes, "paths": {name: solved_scene(name, plr_bytes) for name in names}}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    figure = Figure(figsize=(12.4, 3.9), layout="constrained", facecolor="white")
    axes = figure.subplots(1, len(PANELS), width_ratios=[1.0, 1.0, 1.25])
    for ax, (name, begin, end, title) in zip(axes, PANELS, strict=True):
        plot.plot_path(SCENES[name](), results["paths"][name]["path"], ax, begin=begin, end=end, num_poses=10)
        ax.set_title(title, fontsize=10)
    path = output / "fig3.png"
    plot.save(axes[0], path)
    return [path]


if __name__ == "__main__":
    run("fig3", "Paths of three discs in the cross and of two rectangles in the tangle.", compute, draw)
