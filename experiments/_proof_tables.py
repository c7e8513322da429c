"""The README's tables on proofs: sizes and errors of cones, planes and continuous leaves, and tests of the proofs."""

from typing import Any

from experiments._tables import markdown
from experiments.proving._speed import cone_over_plane

_BYTES_A_CORNER = 4  # two coordinates of 16 bits


def proofs(results: dict[str, Any], oracles: dict[str, Any]) -> str:
    """Bytes, errors and proofs of the leaf models, map by map, and the bytes of the maps themselves."""
    rows = [["map", "leaf", "bytes", "mean error", "largest found", "largest proven", "of distance", "exact", "s"]]
    for row in results["sizes"]["rows"]:
        rows.append(
            [
                *(row["map"], row["leaf"], f"{row['bytes']:,}"),
                *(f"{row[name]:.2g}" for name in ("mean", "largest_found", "proven")),
                *(f"{row['proven'] / row['largest_distance']:.2%}", f"{row['share_exact']:.1%}"),
                f"{row['seconds']:.2f}",
            ]
        )
    worst = max(row["proven_to_found"] for row in results["sizes"]["rows"])
    note = (
        f"Mean over {results['sizes']['points']:,} free points; exact: share of them whose error is at most "
        f"{results['sizes']['exact']:.0e} of the largest distance; seconds from polygons to the certified PLR. The "
        f"largest error that was found is the largest proven one, to a factor of {worst:.3f}. The maps themselves, "
        f"as 16-bit corners, take {_bytes_of_maps(results, oracles)} bytes, mostly less than these files: what files "
        "buy is a query without visibility tests, the proof, and the way home."
    )
    return markdown(rows, numbers=7) + f"\n{note}\n"


def _bytes_of_maps(results: dict[str, Any], oracles: dict[str, Any]) -> str:
    """Of each map of which the benchmark of oracles has counted the corners."""
    corners = {name: each["vertices"] for name, each in oracles["maps"].items() if "vertices" in each}
    names = dict.fromkeys(row["map"] for row in results["sizes"]["rows"] if row["map"] in corners)
    return ", ".join(f"{name} {_BYTES_A_CORNER * corners[name]:,}" for name in names)


def proof_speed(results: dict[str, Any]) -> str:
    """Seconds of queries and builds of cones beside planes."""
    queries, ratios = results["speed"]["queries"], cone_over_plane(results["speed"]["queries"])
    medians = {(row["leaf"], row["max_leaves"]): row["nanoseconds"][0] for row in queries["rows"]}
    rows = [["leaves", *(f"{number:,}" for number in ratios)]]
    for leaf in ("cone", "plane"):
        rows.append([f"{leaf}, ns a point", *(f"{medians[leaf, number]:.2f}" for number in ratios)])
    rows.append(["cone / plane", *(f"{ratio:.2f}" for ratio in ratios.values())])
    builds = ", ".join(
        f"{row['map']} {row['leaf']}s {row['seconds'][0]:.2g} s ({row['leaves']:,} leaves, {row['bytes']:,} bytes)"
        for row in results["speed"]["builds"]
    )
    note = f"{queries['points']:,} points of the {queries['map']}. From workspace to PLR, warm: {builds}."
    return markdown(rows, numbers=len(ratios)) + f"\n{note}\n"


def proof_checks(results: dict[str, Any]) -> str:
    """What was tried against the proofs, and how often one did not hold."""
    rows = [["map", "truth", "points", "broken bounds"]]
    for name, truth in dict.fromkeys((row["map"], row["truth"]) for row in results["bounds"]["rows"]):
        of_leaves = [row for row in results["bounds"]["rows"] if (row["map"], row["truth"]) == (name, truth)]
        points, broken = _counted(of_leaves)
        rows.append([name, truth, points, broken])
    slivers = results["slivers"]
    tried = len(slivers["totals"]) * slivers["num_maps"]
    points, broken = _counted(list(slivers["totals"].values()))
    rows.append([f"{slivers['num_maps']} random ones with slivers", "oracle", points, broken])
    (searches, wrong), (_, misled) = (_searches(results["astar"], kind) for kind in (", lower", " itself"))
    note = (
        "Points times leaf models, which are cones, planes and continuous, with bounds of every leaf; half of the "
        "points are uniform, half "
        "beside walls, corners and borders of cells; brute force shares no code with the package. "
        "Of points from which no path leads to the goal but to the workspace's tolerance, "
        f"{_by_tolerance(results)} are beyond the bounds. "
        f"{len(slivers['refused'])} of {tried} PLRs of random maps could not be built. A* on grids, {searches:,} "
        f"searches under proven lower bounds: {wrong} paths that are not optimal; under PLRs themselves {misled}."
    )
    return markdown(rows, numbers=2) + f"\n{note}\n"


def trace(results: dict[str, Any]) -> str:
    """How many ways home arrive, how many are free, and how much longer they are."""
    rows = [["map", "bytes", "arrive", "meet no wall", "length over exact", "longest"]]
    for row in results["rows"]:
        shares = [f"{row[name]:.2%}" for name in ("arrived", "clear")]
        over = [f"1 + {row['ratio'][name] - 1:.1e}" for name in ("mean", "max")]
        rows.append([row["map"], f"{row['bytes']:,}", *shares, *over])
    note = f"{results['starts']:,} starts; no deeper inside a wall than {results['depth']:.0e} of the map's width."
    return markdown(rows, numbers=5) + f"\n{note}\n"


def _counted(rows: list[dict[str, Any]]) -> tuple[str, str]:
    """Points, and how many break a bound, of all leaf models together."""
    return f"{sum(row['points'] for row in rows):,}", f"{sum(row['violations'] for row in rows):,}"


def _by_tolerance(results: dict[str, Any]) -> int:
    """Points beyond the bounds that are free, or reach the goal, to the tolerance alone."""
    rows = [*results["bounds"]["rows"], *results["slivers"]["totals"].values()]
    return sum(row["by_tolerance"] for row in rows)


def _searches(results: dict[str, Any], kind: str) -> tuple[int, int]:
    """Searches under heuristics of a kind, and those whose path is not optimal."""
    rows = [row for row in results["rows"] if kind in row["heuristic"]]
    return sum(row["problems"] for row in rows), sum(row["not_optimal"] for row in rows)
