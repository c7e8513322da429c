"""The three tables of README.md: a few columns of the results, of which experiments/README.md has all."""

from typing import Any

import numpy as np

from experiments._tables import at_least, markdown, mean_and_largest, spread

_BYTES = 6_144
_APPROXIMATIONS = {
    "PLR, cones": "PLR, cones",
    "PLR": "PLR, planes",
    "PLR, continuous": "PLR, continuous",
    "bilinear grid, 16-bit": "bilinear grid, 16-bit",
    "interpax, cubic, 16-bit": "cubic grid, 16-bit",
    "LinearNDInterpolator": "triangles",
    "LightGBM linear trees": "linear trees",
    "network, 16-bit": "network, 16-bit",
}
_IN_FLOAT64 = ", float64 points"  # in which some rivals are faster
_QUERIES = (
    *("PLR", "map_coordinates", "network", f"SciPy RegularGridInterpolator{_IN_FLOAT64}"),
    *(f"LightGBM linear tree{_IN_FLOAT64}", "Numba loop, one core", "Numba loop, all cores"),
)


def rivals(results: dict[str, Any]) -> str:
    """Mean and largest errors of one number of bytes, one row an approximation and one column a map."""
    maps = results["maps"]
    budgets = {row["budget"] for rows in maps.values() for row in rows}
    budget = _BYTES if _BYTES in budgets else max(budgets)
    table = [[f"error at {budget:,} bytes", *maps]]
    for contender, label in _APPROXIMATIONS.items():
        errors = [
            next((row["free"] for row in rows if (row["contender"], row["budget"]) == (contender, budget)), None)
            for rows in maps.values()
        ]
        if any(errors):  # of what was not measured there is no row
            table.append([label, *map(mean_and_largest, errors)])
    return markdown(table, numbers=len(maps))


def speed(results: dict[str, Any]) -> str:
    """Nanoseconds a point in the plane, beside bytes and error."""
    plane = results["plane"]
    sizes = [str(n) for n in plane["points"] if n > 1]
    table = [["query", "bytes", "mean error", *(f"ns a point of {int(n):,}" for n in sizes)]]
    for contender in _QUERIES:
        if contender in plane["nanoseconds"]:
            size, times = plane["rows"][contender.removesuffix(_IN_FLOAT64)], plane["nanoseconds"][contender]
            cells = [f"{size['bytes']:,}", f"{size['mean']:.2g}", *(f"{times[n][0]:.3g}" for n in sizes)]
            table.append([contender, *cells])
    return markdown(table, numbers=len(table[0]) - 1)


def planning(results: dict[str, Any], race: dict[str, Any]) -> str:
    """Seconds and costs of BL under PLRs, the paper's seconds, and those of the best of OMPL."""
    table = [["scene", "paper s", "s", "cost / bound", "best of OMPL s"]]
    of_ompl = {total["scene"]: total["same_cost"] for total in race["summary"]}
    of_plrs = [row for row in results["rows"] if row["heuristic"] == "PLR"]
    for row in of_plrs:
        best = of_ompl.get(row["scene"])
        cells = [f"{results['paper'].get(row['scene'], {}).get('plr', '-')}", spread(row["seconds"], ".2f")]
        cells += [spread(row["cost_over_bound"], ".3f"), at_least(best, "best") if best else "-"]
        table.append([row["scene"], *cells])
    first = max(np.median(row["seconds_first_run"]) / np.median(row["seconds"]) for row in of_plrs)
    scenes = dict.fromkeys(trial["scene"] for trial in race["trials"])
    sooner = sum(_is_first_path_sooner(race, scene) for scene in scenes)
    return markdown(table, numbers=4) + (
        f"\nOf a second run; a first one compiles, in up to {first:.1f} times as long. A first path, whatever its "
        f"length, RRT-Connect finds sooner in {sooner} of {len(scenes)} scenes.\n"
    )


def _is_first_path_sooner(race: dict[str, Any], scene: str) -> bool:
    """Whether RRT-Connect's first path comes before BL's, by the medians over a scene's variants."""
    trials = [trial for trial in race["trials"] if trial["scene"] == scene]
    ours = [trial["ours"]["history_seconds"][0] for trial in trials]
    theirs = [trial["ompl"]["RRTConnect"]["first_path_seconds"] for trial in trials]
    return float(np.median([np.inf if seconds is None else seconds for seconds in theirs])) < np.median(ours)
