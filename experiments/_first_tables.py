"""Tables of experiments/README.md about first answers and other small costs."""

from typing import Any

from experiments._tables import formatted, markdown


def fresh(results: dict[str, Any]) -> str:
    """Return CPU seconds and errors of new processes, one row for each program."""
    table = formatted(
        results["rows"],
        *(("question", "{question}"), ("by", "{by}"), ("CPU s", "{cpu_seconds:.2f}")),
        *(("mean error", "{mean:.2g}"), ("largest", "{largest:.2g}")),
        words=2,
    )
    return table + (
        f"\nMedians of {results['turns']} processes. Errors are shares of the mean distance. Truths: the exact "
        "oracle; for costs marches over 3,201 x 1,601 and 1,601 x 801 nodes, extrapolated to steps of length 0.\n"
    )


def cost_distance(
    errors: dict[str, Any], bounds: dict[str, Any], mountain: dict[str, Any], large: dict[str, Any]
) -> str:
    """Return errors and seconds of cost distances by several tools, and what bounds, slopes and size cost."""
    table = formatted(
        errors["rows"],
        *(("raster", "{raster}"), ("tool", "{tool}"), ("sources", "{sources}"), ("mean error", "{mean:.2%}")),
        *(("largest", "{largest:.2%}"), ("CPU s", "{cpu_seconds:.2f}"), ("truth off by", "{halved:.2%}")),
        words=2,
    )
    proven = bounds["rows"]
    gaps, seconds = ([row[key] for row in proven] for key in ("gap", "cpu_seconds"))
    hike, big = mountain["rows"], large["rows"][0]
    return table + (
        f"\nErrors are shares of the mean distance, on {errors['side']} x {errors['side']} cells. Truth: "
        f"extrapolated from marches over {errors['finer']} and {errors['finer'] // 2} times as many nodes along each "
        'axis; "truth off by": its mean difference to what half as many nodes give. '
        f"Proven bounds are {min(gaps):.1%} to {max(gaps):.1%} of the mean distance apart and take "
        f"{min(seconds):.0f} to {max(seconds):.0f} CPU s. "
        f"{sum(row['broken'] for row in proven)} bounds are broken: among walls, both bounds are compared with exact "
        "distances, elsewhere only lower bounds, with the march. "
        f"By Tobler's function on a mountain, distances change by {max(row['mean'] for row in hike):.1%} on average "
        f"when the raster is three times finer. {big['side']:,} x {big['side']:,} cells with {big['sources']} "
        f"sources take {big['cpu_seconds'] / 60:.1f} CPU minutes and {big['megabytes'] / 1e3:.1f} GB.\n"
    )


def row_of(entry: dict[str, Any], name: str) -> dict[str, Any]:
    """Return a number of a release, empty if its entry was made before the number was."""
    return next((row for row in entry["numbers"] if row["number"] == name), {})


def history(results: dict[str, Any]) -> str:
    """Return the ratios of the latest releases, one row for each number."""
    latest = dict(list(results["entries"].items())[-4:])
    rows = [["number", "in brackets", *latest]]
    for name, number in results["numbers"].items():
        found = [row_of(entry, name) for entry in latest.values()]
        cells = [f"{row['ratio']:.2g} ({row['beside']:.2g})" if row.get("ratio") else "-" for row in found]
        rows.append([number["what"], number["beside"], *cells])
    return markdown(rows, numbers=len(latest))


def rasters(slopes: dict[str, Any], degrees: dict[str, Any], rivals: dict[str, Any], classes: dict[str, Any]) -> str:
    """Return errors of cost distances beside independent truths: slopes, degrees, other tools, land classes."""
    hike, globe, land = (part["rows"] for part in (slopes, degrees, classes))
    circles, mapped = ([row for row in globe if ("largest_far" in row) == is_circle] for is_circle in (True, False))
    table = formatted(
        rivals["rows"],
        *(("raster", "{raster}"), ("tool", "{tool}"), ("mean error", "{mean:.2%}"), ("largest", "{largest:.1%}")),
        *(("CPU s", "{cpu_seconds:.2f}"), ("truth off by", "{truth_off:.2%}")),
        words=2,
    )
    of_slopes = formatted(
        hike,
        *(("relief", "{relief}"), ("costs", "{costs}"), ("mean error", "{mean:.2%}"), ("largest", "{largest:.1%}")),
        *(("CPU s", "{cpu_seconds:.2f}"), ("truth off by", "{truth_off:.2%}"), ("path's cost off by", "{path:.0e}")),
        words=2,
    )
    of_classes = formatted(
        land,
        *(("costs", "{costs}"), ("mean excess", "{mean:.2%}"), ("largest", "{largest:.1%}")),
        *(("gap of bounds", "{gap:.1%}"), ("truth off by", "{truth_off:.2%}")),
        words=1,
    )
    of_circles = [
        f"{row['mean']:.2%} on average, and {row['largest_far']:.1%} at most beyond 20 cells, at {row['raster']}"
        for row in circles
    ]
    of_maps = [
        f"{row['mean']:.2%} and {row['largest']:.1%} with {row['raster']} (truth off by {row['truth_off']:.2%})"
        for row in mapped
    ]
    notes = (
        "\nErrors are shares of the mean distance; for land classes, of each distance beyond 10 cells. Truths are "
        'graphs of finer nodes; "truth off by": what half as many nodes, or shorter edges, change. In degrees, '
        f"distances differ from great circles by {' and '.join(of_circles)}; from a march over Mercator's map by "
        f"{' and '.join(of_maps)}.\n"
    )
    return f"{table}\nSlopes, by Tobler's function:\n\n{of_slopes}\nLand classes:\n\n{of_classes}{notes}"


def small_costs(certified: dict[str, Any], alone: dict[str, Any], pairs: dict[str, Any]) -> str:
    """Return the CPU time of proofs, of single exact queries and of pairs on large maps."""
    rows = [["what", "map", "CPU"]]
    for row in certified["rows"]:
        size = f"{row['bytes']:,} bytes"
        seconds = f"{row['cpu_with']:.2f} s with, {row['cpu_without']:.2f} s without: {row['ratio']:.2f} times"
        rows.append([f"cones of {size}, with a proof", row["map"], seconds])
    for row in alone["rows"]:
        rows.append(["one exact distance to the goal", row["map"], f"{row['goal_ms']:.3f} ms"])
        rows.append(["one exact distance of two points", row["map"], f"{row['between_ms']:.3f} ms"])
    for row in pairs["rows"]:
        rows.append([f"one of {pairs['pairs']:,} pairs, {row['bytes']:,} bytes", row["map"], f"{row['us']:.2f} us"])
    return markdown(rows, numbers=1)
