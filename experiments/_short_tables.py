"""The three tables of README.md: a few columns of the results, of which experiments/README.md has all."""

from typing import Any

from experiments._tables import at_least, markdown, mean_and_largest, spread

_BYTES = 6_144
_APPROXIMATIONS = {
    "PLR, cones": "PLR, cones",
    "PLR": "PLR, planes",
    "PLR, continuous": "PLR, continuous",
    "bilinear grid, 16-bit": "bilinear grid, 16-bit",
    "network, 16-bit": "network, 16-bit",
}
_IN_FLOAT64 = ", float64 points"  # in which some rivals are faster
_QUERIES = (
    *("PLR", "map_coordinates", "network", f"SciPy RegularGridInterpolator{_IN_FLOAT64}"),
    "Numba loop, all cores",
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


_IN_BETWEEN = "four rooms 3", "cross 2", "crowd 25"
"""Scenes whose smaller and larger siblings say as much; they are in the tables of all results."""


def planning(results: dict[str, Any], race: dict[str, Any]) -> str:
    """Seconds and costs of ``bl_plan``, the paper's seconds, and those of the best of OMPL."""
    table = [["scene", "paper s", "s", "cost / bound", "best of OMPL s"]]
    rows = {row["scene"]: row for row in results["rows"] if row["heuristic"] == "lattice"}
    for total in race["summary"]:
        name, same = total["scene"], total["same_cost"]
        if name in _IN_BETWEEN:
            continue
        row = rows.get(name) or _row_of(race, name)
        cells = [f"{results['paper'].get(name, {}).get('plr', '-')}", spread(row["seconds"], ".2f")]
        table.append([name, *cells, spread(row["cost_over_bound"], ".3f"), at_least(same, "best")])
    sooner = sum(total["first_path"]["best"] < total["first_path"]["ours"] for total in race["summary"])
    count = len(race["summary"])
    return markdown(table, numbers=4) + (
        f"\nA first path, whatever its length, one of OMPL's finds sooner in {sooner} of {count} scenes.\n"
    )


def _row_of(race: dict[str, Any], scene: str) -> dict[str, Any]:
    """Our seconds and costs in the race."""
    trials = [trial for trial in race["trials"] if trial["scene"] == scene]
    ratios = [trial["ours"]["cost"] / trial["lower_bound"] for trial in trials]
    return {"seconds": [trial["ours"]["seconds"] for trial in trials], "cost_over_bound": ratios}
