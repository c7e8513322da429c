"""Whether anything breaks, crashes or hangs on random maps that are nearly degenerate, of all scales and far away.

Corners lie on earlier corners, on earlier walls, on a lattice of eighths, or anywhere; walls are from 1e-13 to 1e-7
of the width thick; half of the maps are far from the origin, by up to 1e10 widths. Of each map: certified cones and
planes, whose bounds are held against the oracle at free points, and of every fifth one pairs, against the oracle of
each of some points both ways round. A map's number gives it back: its seed is ``[seed, number]``.
"""

import signal
from collections import Counter
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from plr_jax import VisibilityGraph, Workspace, construct, construct_pairs
from plr_jax.geometry.boundary import as_polygon

MAPS, LEAVES, POINTS, GOALS = 5_000, ("cone", "plane"), 300, 8
SECONDS = 120  # after which a map counts as one that hangs
_FEW = 16  # leaves
_EVERY = 5  # map has pairs

Ring = Float[np.ndarray, "n 2"]


def degenerate(seed: int, smoke: bool) -> dict[str, Any]:
    signal.signal(signal.SIGALRM, _hangs)
    counts: Counter[str] = Counter()
    examples: list[dict[str, Any]] = []
    for number in tqdm(range(10 if smoke else MAPS), desc="degenerate", disable=None):
        if number % 100 == 0 and not smoke:
            jax.clear_caches()
        signal.alarm(SECONDS)
        try:
            found = _measured(np.random.default_rng([seed, number]), with_pairs=number % _EVERY == 0)
        except KeyboardInterrupt:  # what was measured of the maps before counts
            break
        except Exception as error:  # whatever goes wrong on a random map is a result
            found = Counter({"crashed": 1})
            examples.append({"map": number, "error": f"{type(error).__name__}: {error}"})
        finally:
            signal.alarm(0)
        counts.update(found)
        if any(kind.startswith("broken") for kind in found):
            examples.append({"map": number, **found})
    return {"counts": dict(sorted(counts.items())), "examples": examples}


def _hangs(*_: Any) -> None:
    raise TimeoutError(f"it takes more than {SECONDS} s")


def _measured(rng: np.random.Generator, with_pairs: bool) -> Counter[str]:
    """What is built, refused and broken on one map."""
    bounds, rings = random_rings(rng)
    counts = Counter({"maps": 1})
    try:
        workspace = Workspace(bounds, rings)
        x = workspace.sample_free(POINTS, int(rng.integers(2**31)))
    except ValueError:
        return counts + Counter({"maps refused": 1})
    oracle, slack = VisibilityGraph(workspace, x[0]), 4 * workspace.tolerance
    distance = oracle(x)
    for leaf in LEAVES:
        try:
            plr = construct(oracle, workspace.bounds, leaf=leaf, max_leaves=_FEW, certified=True).numpy()
        except ValueError:
            counts[f"{leaf} refused"] += 1
            continue
        counts[leaf] += 1
        counts[f"broken {leaf}"] += _broken(distance, *plr.bounds(x), slack)
    if with_pairs:
        try:
            pairs = construct_pairs(workspace, max_bytes=2_000)
        except ValueError:
            counts["pairs refused"] += 1
        else:
            counts["pairs"] += 1
            lower, upper = pairs.bounds(x[:GOALS, None], x)
            there = np.stack([oracle.with_goal(goal)(x) for goal in x[:GOALS]])
            back = np.stack([oracle.with_goal(point)(x[:GOALS]) for point in x[:GOALS]])
            counts["broken pairs"] += _broken(there, lower, upper, slack)
            counts["broken symmetry"] += _broken(back, back.T, back.T, slack)
    return +counts


def _broken(distance: np.ndarray, lower: Any, upper: Any, slack: float) -> int:
    """How many distances are not between their bounds, of points that reach the goal."""
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    holds = (lower - slack <= distance) & (distance <= upper + slack)
    return int((~holds & np.isfinite(distance)).sum())


def random_rings(rng: np.random.Generator) -> tuple[tuple[Ring, Ring], list[Ring]]:
    """Bounds, and up to 8 obstacles that are polygons."""
    scale, size = 10.0 ** rng.integers(-3, 7), np.array([1.0, rng.choice([1.0, 0.3, 0.01])])
    far = size.max() * 10.0 ** rng.uniform(0, 10) * rng.normal(size=2) * (rng.random() < 0.5)
    rings: list[Ring] = []
    for _ in range(rng.integers(1, 9)):
        a, b, c = (_point(rng, rings, size) for _ in range(3))
        across = np.array([a[1] - b[1], b[0] - a[0]])
        thick = 10.0 ** rng.uniform(-13, -7) * rng.choice([-1, 1]) * across / max(np.linalg.norm(across), 1e-300)
        lo, hi = np.minimum(a, b), np.maximum(a, b)
        corners = [
            [a, b, c],
            [a, b, b + thick],
            [a, b, b + thick, a + thick],
            [a, (a + b) / 2 + thick, b, c],
            [lo, (hi[0], lo[1]), hi, (lo[0], hi[1])],
            [point + thick for point in rings[-1]] if rings else [a, b, c],
        ]
        rings.append(np.array(corners[rng.integers(len(corners))]))
    kept = []
    for ring in (scale * (far + ring) for ring in rings):
        try:
            kept.append(as_polygon("the ring", ring))
        except ValueError:  # it is none
            continue
    return (scale * far, scale * (far + size)), kept


def _point(rng: np.random.Generator, rings: list[Ring], size: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
    kind = rng.integers(4)
    if kind < 2 and rings:
        ring = rings[rng.integers(len(rings))]
        at, share = rng.integers(len(ring)), rng.random() * kind
        return (1 - share) * ring[at] + share * ring[at - 1]
    return rng.integers(0, 9, 2) / 8 * size if kind == 2 else rng.uniform(-0.1, 1.1, 2) * size
