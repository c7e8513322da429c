"""A map in UTM coordinates beside the same map at the origin: mean errors of NumPy's 64-bit points, and of 32 bits.

The maze, 2,000 units wide, and goal are moved by (5e5, 4e6). The tables of PLRs are in 32 bits, which resolve such
coordinates to a quarter of a unit.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
import shapely
from jaxtyping import Float

from plr_jax import VisibilityGraph, Workspace, construct, construct_pairs, scenes, stack

OFFSET, WIDTH = np.array([5e5, 4e6]), 2000.0
LEAVES, NUM_BYTES, NUM_POINTS, NUM_PAIRS = ("plane", "continuous", "smooth", "cone"), 4096, 100_000, 10_000


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    num_bytes, num_points, num_pairs = (512, 500, 100) if smoke else (NUM_BYTES, NUM_POINTS, NUM_PAIRS)
    maps = [_moved_maze(origin) for origin in (np.zeros(2), OFFSET)]
    x = maps[0][0].sample_free(num_points, seed)
    distances = maps[0][1](x)
    rows = []
    for leaf in LEAVES:
        near, far = (construct(oracle, space.bounds, leaf=leaf, max_bytes=num_bytes) for space, oracle in maps)
        moved = x + OFFSET
        rows.append(_row(leaf, near(x), far(moved), far(jnp.asarray(moved)), distances))
        nears, fars = stack([near, near]), stack([far, far])
        answers = nears(0, x), fars(0, moved), fars(0, jnp.asarray(moved))
        rows.append(_row(f"stack, {leaf}", *answers, distances))
    y, x = maps[0][0].sample_free(num_pairs, seed + 1), x[:num_pairs]
    near, far = (construct_pairs(space, max_bytes=num_bytes) for space, _ in maps)
    single = far(jnp.asarray(x + OFFSET), jnp.asarray(y + OFFSET))
    rows.append(_row("pairs", near(x, y), far(x + OFFSET, y + OFFSET), single, maps[0][1].between(x, y)))
    return {"bytes": num_bytes, "points": num_points, "pairs": num_pairs, "rows": rows}


def _moved_maze(origin: Float[np.ndarray, "2"]) -> tuple[Workspace, VisibilityGraph]:
    maze = scenes.maze()
    walls = [origin + WIDTH * shapely.get_coordinates(wall) for wall in maze.workspace.obstacles]
    workspace = Workspace((origin, origin + WIDTH), walls)
    return workspace, VisibilityGraph(workspace, origin + WIDTH * maze.goals[0])


def _row(what: str, near: Any, far: Any, single: Any, distances: Float[np.ndarray, "n"]) -> dict[str, Any]:
    errors = [float(np.abs(np.asarray(each, np.float64) - distances).mean()) for each in (near, far, single)]
    return {"what": what, "error": errors[0], "ratio": errors[1] / errors[0], "ratio_32_bits": errors[2] / errors[0]}


def table(results: dict[str, Any]) -> str:
    lines = [
        f"{row['what']:20} mean error at the origin {row['error']:9.2e}  far / at the origin {row['ratio']:7.4f}, "
        f"of 32-bit points {row['ratio_32_bits']:9.4f}\n"
        for row in results["rows"]
    ]
    return "".join(lines)
