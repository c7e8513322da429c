"""Where Theorem 2 of the paper holds, where it does not, and the bound that takes its place.

The theorem: in a cell of edge length ``e``, path subconvex, ``|V - L| <= 5/2 kappa e sqrt(n)``. Its proof says that
least squares keeps ``L`` at the base points between the smallest and the largest ``V`` there, and that the slope of
``L`` is at most ``kappa``. Neither is so:

- on a line, base points 0, 1, 2 of values 0, 0, 1: least squares gives -1/6 at 0;
- in the plane, three base points nearly on a line, a goal between the first two: the slope across the line, and with
  it the error, is as large as one likes, in an empty cell with a distance that is Euclidean;
- in a PLR of the maze, leaves whose planes leave the range of the distance at their base points;
- in the paper's own partition (axes in turn, depth 9), leaves that walls cross are not path subconvex, and their
  errors can be beyond the number that the theorem states.

What is proven instead are bounds of every leaf, which hold at all of these points.
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from experiments._tables import aligned
from plr_jax import PLR, VisibilityGraph, Workspace, certify, construct, cyclic_axis, maximum_depth, scenes

_ASIDE = 0.02  # of the third base point
_GRID = 9  # base points a side of a leaf
_MORE = 1e-6  # than queries round
BYTES = 1_024
_MAPS = ("maze", "thin_maze")


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    results: dict[str, Any] = {"line": on_a_line(), "nearly_on_a_line": nearly_on_a_line(), "maps": {}}
    for name in _MAPS[: 1 if smoke else None]:
        problem = getattr(scenes, name)()
        workspace, oracle = problem.workspace, VisibilityGraph(problem.workspace, problem.goals[0])
        points = 20_000 if smoke else 2_000_000
        ours = construct(oracle, workspace.bounds, max_bytes=BYTES, certified=True, leaf_bounds=True, seed=seed)
        rules = {"should_split": maximum_depth, "split": cyclic_axis, "max_depth": 5 if smoke else 9}
        papers = construct(oracle, workspace.bounds, seed=seed, **rules)
        results["maps"][name] = {
            "beyond_range": beyond_range(ours, oracle),
            "paper_partition": paper_partition(papers, oracle, workspace.sample_free(points, seed)),
        }
    return results


def on_a_line() -> dict[str, Any]:
    """The smallest case: the plane of least squares is below the smallest value."""
    x, values = np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.0, 1.0])
    slope, intercept = np.polyfit(x, values, 1)
    return {"x": x.tolist(), "values": values.tolist(), "fitted": (slope * x + intercept).tolist()}


def nearly_on_a_line() -> dict[str, Any]:
    """The unit square, empty, a goal in the middle of its lower side, and three base points near that side."""
    goal = np.array([0.5, 0.0])
    base = np.array([(0.0, 0.0), (1.0, 0.0), (0.5, _ASIDE)])
    oracle = VisibilityGraph(Workspace(((0, 0), (1, 1))), goal)
    plane = _least_squares(base, oracle(base))
    corner = np.array([[0.5, 1.0]])
    error = float(np.abs(_values(plane, corner) - oracle(corner))[0])
    return {
        "base": base.tolist(),
        "goal": goal.tolist(),
        "at": corner[0].tolist(),
        "error": error,
        "bound": _bound(1.0),
    }


def beyond_range(plr: PLR, oracle: VisibilityGraph) -> dict[str, Any]:
    """Leaves of a PLR with base points, a grid of those free, at which least squares leaves the range of values.

    Of the worst also what the PLR holds there, and its proven interval.
    """
    lo, hi = plr.leaf_boxes
    share = (np.stack(np.meshgrid(*[np.arange(_GRID)] * 2), axis=-1).reshape(-1, 2) + 0.5) / _GRID
    base = (lo[:, None] + share * (hi - lo)[:, None]).reshape(-1, 2)
    values, answers = oracle(base), np.asarray(plr(base), float)
    lower, upper = (np.asarray(bound, float) for bound in plr.bounds(base))
    members = [
        np.flatnonzero(np.isfinite(part)) + i * len(share) for i, part in enumerate(values.reshape(len(lo), -1))
    ]
    members = [member for member in members if len(member) > 3]
    fitted = [_values(_least_squares(base[member], values[member]), base[member]) for member in members]
    beyond = np.array([_outside(fit, values[member]) for fit, member in zip(fitted, members, strict=True)])
    of_plr = np.array([_outside(answers[member], values[member]) for member in members])
    worst = members[int(np.argmax(of_plr))]
    least, most = values[worst].min(), values[worst].max()
    at = worst[np.argmax(np.maximum(least - answers[worst], answers[worst] - most))]
    leaf = at // len(share)
    reached = np.isfinite(values)
    return {
        "leaves": len(lo),
        "fits": len(members),
        "fits_beyond": int((beyond > _MORE).sum()),
        "plr_beyond": int((of_plr > _MORE).sum()),
        "worst": {
            "lo": lo[leaf].tolist(),
            "hi": hi[leaf].tolist(),
            "base_points": len(worst),
            "range": [float(least), float(most)],
            "x": base[at].tolist(),
            "answer": float(answers[at]),
            "distance": float(values[at]),
            "proven": [float(lower[at]), float(upper[at])],
        },
        "proven_hold": bool(((values >= lower) & (values <= upper))[reached].all()),
    }


def paper_partition(plr: PLR, oracle: VisibilityGraph, x: Float[np.ndarray, "n 2"]) -> dict[str, Any]:
    """Largest errors of leaves beside the theorem's number, where no wall crosses them and where some do."""
    proven = certify(plr, oracle, leaf_bounds=True)
    lo, hi = plr.leaf_boxes
    leaf, distance = _leaf_of(lo, hi, x), oracle(x)
    errors = np.abs(np.asarray(plr(x), float) - distance)
    largest = np.zeros(len(lo))
    np.maximum.at(largest, leaf, errors)
    is_open = np.array([_is_open(oracle.workspace, *corners) for corners in zip(lo, hi, strict=True)])
    to_bound = largest / _bound((hi - lo).max(axis=1))
    lower, upper = (np.asarray(bound, float) for bound in proven.bounds(x))
    return {
        "leaves": len(lo),
        "open_leaves": int(is_open.sum()),
        "beyond_in_open": int((to_bound[is_open] > 1).sum()),
        "largest_in_open": float(to_bound[is_open].max(initial=0.0)),
        "beyond_in_crossed": int((to_bound[~is_open] > 1).sum()),
        "largest_in_crossed": float(to_bound[~is_open].max(initial=0.0)),
        "proven_violations": int(((distance < lower) | (distance > upper)).sum()),
        "points": len(x),
    }


def _bound(edge: Any) -> Any:
    """The theorem's number, in the plane, for distances that grow by one a unit of length."""
    return 2.5 * edge * np.sqrt(2)


def _least_squares(base: Float[np.ndarray, "k 2"], values: Float[np.ndarray, "k"]) -> Float[np.ndarray, "3"]:
    return np.linalg.lstsq(np.column_stack([np.ones(len(base)), base]), values, rcond=None)[0]


def _values(plane: Float[np.ndarray, "3"], x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
    return plane[0] + x @ plane[1:]


def _outside(answers: Float[np.ndarray, "k"], values: Float[np.ndarray, "k"]) -> float:
    """How far the range of answers goes beyond that of values."""
    return float(max(values.min() - answers.min(), answers.max() - values.max()))


def _is_open(workspace: Workspace, lo: Float[np.ndarray, "2"], hi: Float[np.ndarray, "2"]) -> bool:
    """Whether no wall reaches into a box: its center is free, and no vertex or edge of a wall is inside."""
    start, end = workspace.boundary.segments.transpose(1, 0, 2)
    step = np.where(end == start, 1e-300, end - start)
    with np.errstate(over="ignore"):
        first, last = (lo - start) / step, (hi - start) / step
    enter = np.maximum(np.minimum(first, last).max(axis=1), 0)
    leave = np.minimum(np.maximum(first, last).min(axis=1), 1)
    return bool(workspace.is_free((lo + hi)[None] / 2)[0] and not (enter < leave).any())


def _leaf_of(
    lo: Float[np.ndarray, "leaves 2"], hi: Float[np.ndarray, "leaves 2"], x: Float[np.ndarray, "n 2"]
) -> Int[np.ndarray, "n"]:
    """The leaf that holds each point, by brute force."""
    leaf = np.zeros(len(x), int)
    for number in range(len(lo)):
        leaf[((x >= lo[number]) & (x <= hi[number])).all(axis=1)] = number
    return leaf


def table(results: dict[str, Any]) -> str:
    line, near = results["line"], results["nearly_on_a_line"]
    texts = [
        f"on a line: values {line['values']}, least squares gives {line['fitted'][0]:.6f} at {line['x'][0]:g}",
        f"three base points nearly on a line: error {near['error']:.3g}, Theorem 2 states {near['bound']:.3g}",
    ]
    rows = [["map", "paper's leaves", "error / bound at most", "leaves beyond", "proven bounds broken"]]
    for name, each in results["maps"].items():
        found, part = each["beyond_range"], each["paper_partition"]
        worst = found["worst"]
        texts.append(
            f"{name}: {found['fits_beyond']} of {found['fits']} fits leave the range of their values, and "
            f"{found['plr_beyond']} of the PLR's planes; that of {worst['lo']} to {worst['hi']} answers "
            f"{worst['answer']:.5f} at {worst['x']}, where values go from {worst['range'][0]:.5f} to "
            f"{worst['range'][1]:.5f}; proven there: {worst['proven'][0]:.5f} to {worst['proven'][1]:.5f}, "
            f"true {worst['distance']:.5f}"
        )
        for kind, count in (("open", part["open_leaves"]), ("crossed", part["leaves"] - part["open_leaves"])):
            numbers = [f"{part[f'largest_in_{kind}']:.3f}", f"{part[f'beyond_in_{kind}']}"]
            rows.append([name, f"{count} {kind}", *numbers, f"{part['proven_violations']} of {part['points']:,}"])
    return aligned(rows, numbers=3) + "\n".join(texts) + "\n"
