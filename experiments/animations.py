"""Every scene of Table II solved by BL with PLRs, in motion: a page each, and a GIF of four robots in four rooms."""

from pathlib import Path
from typing import Any

from experiments._planning import PLR_BYTES, SCENES, SMOKE_BYTES, solved_scene
from experiments._results import run
from plr_jax import plot

GIF = "four rooms 4"


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    """The scenes as published; nothing here is random."""
    names, plr_bytes = (["single door", GIF], SMOKE_BYTES) if smoke else (SCENES, PLR_BYTES)
    paths = {name: solved_scene(name, plr_bytes) for name in names}
    return {"plr_bytes": plr_bytes, "seconds": 1 if smoke else 6, "paths": paths}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    files = []
    for name, entry in results["paths"].items():
        animation = plot.animate(
            SCENES[name](), entry["path"], seconds=results.get("seconds", 6), frames_per_second=12.5
        )
        for ending in (".html", ".gif") if name == GIF else (".html",):
            file = output / f"{name.replace(' ', '_')}{ending}"
            animation.save(file)
            files.append(file)
    return files


if __name__ == "__main__":
    run("animations", "The solutions of all scenes in motion.", compute, draw)
