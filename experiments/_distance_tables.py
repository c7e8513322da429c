"""Tables of README files about distances: errors, proofs, without an oracle, all pairs, time of a query."""

from collections.abc import Iterable
from itertools import chain
from typing import Any

from experiments._tables import formatted, markdown, mean_and_largest, or_dash, spread
from experiments.compare_summaries import MAX_BYTES, TOLERANCE

_SHORT_BYTES = 6_144
_PLRS = ("PLR, cones", "PLR, planes", "PLR, continuous")
_SHORT_CONTENDERS = (*_PLRS, "coded grid", "network, 16-bit")
_SPEED_CONTENDERS = ("PLR, planes", "grid, JAX", "grid, SciPy")
_BYTES_A_CORNER = 4  # two coordinates of 16 bits
_RIVALS = {
    "ours": "construct_pairs",
    "product_plr": "PLR over pairs",
    "straight_line": "straight line",
    "full_table": "full table",
    "landmark_tables": "landmarks, tables",
    "landmark_plrs": "landmarks, PLRs",
    "fastmap": "FastMap",
    "network": "network, 16-bit",
    "polygon": "polygon, exact oracle",
}


def rivals(results: dict[str, Any], query: dict[str, Any]) -> str:
    """Errors at one number of bytes, one row an approximation and one column a map; and of a grid in equal memory.

    Below the table are times of queries of planes and of grids of about as many bytes. The page of results has all
    maps and contenders; ``thin_maze`` gives nearly the numbers of ``maze``.
    """
    maps = {
        name: {row["contender"]: row for row in rows if row["budget"] == _SHORT_BYTES}
        for name, rows in results["maps"].items()
        if name != "thin_maze"
    }
    table = [[f"mean (largest) error, {_SHORT_BYTES:,} bytes", *maps]]
    for contender in _SHORT_CONTENDERS:
        table.append([contender, *(mean_and_largest(rows[contender]["free"]) for rows in maps.values())])
    in_memory = [mean_and_largest(rows["PLR, planes"]["grid_in_memory"]) for rows in maps.values()]
    table.append(["32-bit grid, memory of planes", *in_memory])
    sizes, nanoseconds = [n for n in query["plane"]["points"] if n > 1], query["plane"]["nanoseconds"]
    times = "; ".join(
        f"{name} {' and '.join(f'{nanoseconds[name][str(n)][0]:.3g}' for n in sizes)}" for name in _SPEED_CONTENDERS
    )
    batches = " and ".join(f"{n:,}" for n in sizes)
    line = f"Nanoseconds a point in batches of {batches} (maze; JAX in `jit`): {times}."
    return markdown(table, numbers=len(maps)) + f"\n{line}\n"


def cones_and_best_rival(results: dict[str, Any], name: str, budget: int) -> tuple[float, float, str]:
    """Return the mean error of cones on a map, the least mean error of other methods, and the name of that method."""
    errors = {row["contender"]: row["free"]["mean"] for row in results["maps"][name] if row["budget"] == budget}
    least = min((error, contender) for contender, error in errors.items() if contender not in _PLRS)
    return errors["PLR, cones"], *least


def memory(results: dict[str, Any]) -> str:
    """Errors of loaded PLRs beside those of grids that take as much memory."""
    rows = [
        {"map": name, "cells": [mean_and_largest(row[key]) for key in ("free", "grid_in_memory")], **row}
        for name, rows in results["maps"].items()
        for row in rows
        if row["contender"] in _PLRS and row["budget"] == _SHORT_BYTES
    ]
    return formatted(
        rows,
        *(("map", "{map}"), ("", "{contender}"), ("file, bytes", "{bytes:,}"), ("memory", "{resident_bytes:,}")),
        *(("mean (largest) error", "{cells[0]}"), ("of the grid", "{cells[1]}")),
        words=2,
    )


def leaves(results: dict[str, Any]) -> str:
    """Bytes, errors and proofs of each leaf model at one budget, map by map."""
    table = formatted(
        results["rows"],
        *(("map", "{map}"), ("leaf", "{leaf}"), ("file, bytes", "{bytes:,}"), ("memory", "{resident_bytes:,}")),
        *(("in C", "{c_bytes:,}"), ("mean error", "{mean:.2g}"), ("largest found", "{largest:.2g}")),
        ("proven", "{proven:.2g}"),
        words=2,
    )
    farthest = {row["map"]: row["largest_distance"] for row in results["rows"]}
    scale = ", ".join(f"{distance:.3g} in {name}" for name, distance in farthest.items())
    return table + (
        f"\n`max_bytes={results['budget']}`. Memory: bytes once loaded. In C: bytes of code and tables. "
        f"Errors in workspace units; largest distance: {scale}.\n"
    )


def query(results: dict[str, Any]) -> str:
    """Bytes, error and nanoseconds a point of every contender in the maze, and of the joint distance."""
    plane, joint = results["plane"], results["joint"]
    return _nanoseconds(plane, plane["nanoseconds"]) + (
        f"\nMedians of interleaved calls in one process; the PLR has {plane['leaves']:,} leaves; errors are of "
        "free points. "
        f"A 4-D PLR of {joint['leaves']:,} leaves, the joint distance of two robots, takes "
        f"{joint['nanoseconds']['PLR'][0]:.1f} ns a point in a batch of {plane['points'][-1]:,}.\n"
    )


def _nanoseconds(plane: dict[str, Any], contenders: Iterable[str]) -> str:
    sizes = [str(n) for n in plane["points"] if n > 1]
    rows = [["", "bytes", "mean error", *(f"ns a point of {int(n):,}" for n in sizes)]]
    for contender in contenders:
        size = plane["rows"].get(contender)
        cells = [f"{size['bytes']:,}", f"{size['mean']:.2g}"] if size else ["", ""]
        rows.append([contender, *cells, *(f"{plane['nanoseconds'][contender][n][0]:.3g}" for n in sizes)])
    return markdown(rows, numbers=len(rows[0]) - 1)


def accuracy(results: dict[str, Any]) -> str:
    """Mean errors at equal bytes, one row a map and a contender."""
    maps = results["maps"]
    budgets = list(dict.fromkeys(row["budget"] for rows in maps.values() for row in rows))
    table = [["map", "", *(f"{budget:,} bytes" for budget in budgets)]]
    for name, rows in maps.items():
        for contender in dict.fromkeys(row["contender"] for row in rows):
            errors = {row["budget"]: row["free"] for row in rows if row["contender"] == contender}
            table.append([name, contender, *(mean_and_largest(errors.get(budget)) for budget in budgets)])
    note = "Mean error, and in brackets the largest, over random free points; *: the method leaves some points out."
    return markdown(table, numbers=len(budgets)) + f"\n{note}\n"


def oracle(results: dict[str, Any]) -> str:
    """Preparation and queries of the exact oracle beside two libraries."""
    maps = {name: each for name, each in results["maps"].items() if "skipped" not in each}
    names = list(dict.fromkeys(chain.from_iterable(each.get("rivals", ()) for each in maps.values())))
    rows = [
        ["map", "vertices", "prepare s", "us a point", *(f"{name}: {what}" for name in names for what in ("s", "us"))]
    ]
    for name, each in maps.items():
        batched = each["microseconds_a_point"][max(each["microseconds_a_point"], key=int)]
        cells = [
            f"{each['vertices']:,}",
            f"{each['seconds_workspace'] + each['seconds_prepare']:.2g}",
            f"{batched:.2g}",
        ]
        for rival in (each["rivals"][name] for name in names):
            if "skipped" in rival:
                cells += [f"> {results['rival_limit']:g}" if rival.get("over_limit") else "-", "-"]
            else:
                cells += [f"{rival['prepare']:.2g}", f"{1e6 * rival['query']:,.0f}"]
        rows.append([name, *cells])
    return markdown(rows, numbers=len(rows[0]) - 1) + (
        "\nOur queries are batched; the others offer one point a call. Preparation includes the workspace.\n"
    )


def proofs(results: dict[str, Any], oracles: dict[str, Any]) -> str:
    """Bytes, errors and proofs of the leaf models, map by map, and the bytes of the maps themselves."""
    sizes = results["sizes"]
    table = formatted(
        (row | {"share": row["proven"] / row["largest_distance"]} for row in sizes["rows"]),
        *(("map", "{map}"), ("leaf", "{leaf}"), ("bytes", "{bytes:,}"), ("mean error", "{mean:.2g}")),
        *(
            ("largest found", "{largest_found:.2g}"),
            ("largest proven", "{proven:.2g}"),
            ("of distance", "{share:.2%}"),
        ),
        *(("exact", "{share_exact:.1%}"), ("s", "{seconds:.2f}")),
        words=2,
    )
    worst = max(row["proven_to_found"] for row in sizes["rows"])
    corners = {name: each["vertices"] for name, each in oracles["maps"].items() if "vertices" in each}
    names = dict.fromkeys(row["map"] for row in sizes["rows"] if row["map"] in corners)
    of_maps = ", ".join(f"{name} {_BYTES_A_CORNER * corners[name]:,}" for name in names)
    return table + (
        f"\nMeans over {sizes['points']:,} free points. Exact: share of points whose error is at most "
        f"{sizes['exact']:.0e} of the largest distance. Seconds: from polygons to the certified PLR. The proven "
        f"largest error is at most {worst:.3f} times the measured one. The corners of the maps, as 16-bit numbers, "
        f"take {of_maps} bytes, less than any of their files here. In return, queries of the files need no "
        "visibility tests, and the files prove errors and give paths to the goal.\n"
    )


def proof_speed(results: dict[str, Any]) -> str:
    """Seconds of queries and builds of cones beside planes."""
    queries = results["speed"]["queries"]
    medians = {(row["leaf"], row["max_leaves"]): row["nanoseconds"][0] for row in queries["rows"]}
    numbers = [number for leaf, number in medians if leaf == "cone"]
    rows = [["leaves", *(f"{number:,}" for number in numbers)]]
    for leaf in ("cone", "plane"):
        rows.append([f"{leaf}, ns a point", *(f"{medians[leaf, number]:.2f}" for number in numbers)])
    rows.append(["cone / plane", *(f"{medians['cone', n] / medians['plane', n]:.2f}" for n in numbers)])
    builds = ", ".join(
        f"{row['map']} {row['leaf']}s {row['seconds'][0]:.2g} s ({row['leaves']:,} leaves, {row['bytes']:,} bytes)"
        for row in results["speed"]["builds"]
    )
    note = (
        f"A batch of {queries['points']:,} points of the {queries['map']}. Warm build, from the workspace: {builds}."
    )
    return markdown(rows, numbers=len(numbers)) + f"\n{note}\n"


def proof_checks(results: dict[str, Any]) -> str:
    """What was tried against the proofs, and how often one did not hold."""
    slivers, groups = results["slivers"], {}
    for row in results["bounds"]["rows"]:
        groups.setdefault((row["map"], row["truth"]), []).append(row)
    groups[f"{slivers['num_maps']} random ones with slivers", "oracle"] = list(slivers["totals"].values())
    rows = [["map", "truth", "points", "broken bounds"]]
    for names, group in groups.items():
        rows.append([*names, *(f"{sum(row[what] for row in group):,}" for what in ("points", "violations"))])

    def searches(kind: str, what: str) -> int:
        return sum(row[what] for row in results["astar"]["rows"] if kind in row["heuristic"])

    note = (
        "Each point counts once for each leaf model: cones, planes and continuous leaves, with bounds of every leaf. "
        "Half of the points are uniform, half lie beside walls, corners and borders of cells. The brute-force truth "
        "shares no code with the package. "
        f"{sum(row['by_tolerance'] for row in chain.from_iterable(groups.values()))} points that reach the goal only "
        "within the workspace's tolerance, not exactly, are outside the bounds. "
        f"{len(slivers['refused'])} of {len(slivers['totals']) * slivers['num_maps']} PLRs of random maps could not "
        f"be built. In {searches(', lower', 'problems'):,} A* searches on grids with proven lower bounds as the "
        f"heuristic, {searches(', lower', 'not_optimal')} paths were not optimal; of "
        f"{searches(' itself', 'problems'):,} with the PLRs' estimates, "
        f"{searches(' itself', 'not_optimal')} were not."
    )
    return markdown(rows, numbers=2) + f"\n{note}\n"


def trace(results: dict[str, Any]) -> str:
    """How many ways home arrive, how many are free, and how much longer they are."""
    table = formatted(
        (row | {"over": {name: ratio - 1 for name, ratio in row["ratio"].items()}} for row in results["rows"]),
        *(("map", "{map}"), ("bytes", "{bytes:,}"), ("arrive", "{arrived:.2%}"), ("meet no wall", "{clear:.2%}")),
        *(("length over exact", "1 + {over[mean]:.1e}"), ("longest", "1 + {over[max]:.1e}")),
    )
    return table + (
        f"\n{results['starts']:,} starts. A path meets no wall if it is nowhere deeper inside a wall than "
        f"{results['depth']:.0e} of the map's width.\n"
    )


def _solved(what: str, rows: list[dict[str, Any]], **shares: str) -> str:
    """A row a method and size, its tests of all kinds together; shares may be unknown."""
    table = [[what, "method", "cells or samples", "bytes", "s", "tests", *shares.values()]]
    for row in rows:
        size = [f"{row['cells']:,}", f"{row['bytes']:,}", f"{row['seconds']:.3g}"]
        tests = f"{sum(row['tests'][kind] for kind in ('configurations', 'motions', 'boxes')):,}"
        table.append([row[what], row["method"], *size, tests, *(or_dash(row.get(name), ".2%") for name in shares)])
    return markdown(table, numbers=4 + len(shares))


def solve_plane(results: dict[str, Any]) -> str:
    """Sizes, seconds, tests, errors and gaps in the plane."""
    shares = {"mean": "mean error", "largest": "largest", "unanswered": "no answer", "below": "below truth"}
    shares |= {"gap": "upper - lower", "without_upper": "no upper"}
    ours = [row for row in results["rows"] if row["method"] == "solve_eikonal"]
    first = results["first_call"]
    return _solved("map", results["rows"], **shares) + (
        f"\nErrors and gaps are shares of the mean distance of {results['points']:,} random free points. Size means "
        "cells of the solver, or samples of a roadmap. Bounds were tested at "
        f"{ours[0]['points_tested']:,} points a map for each of {len(ours)} PLRs: "
        f"{sum(row['lower_violated'] for row in ours)} distances are below a lower bound, "
        f"{sum(row['upper_violated'] for row in ours)} above an upper bound. The first call in a process takes "
        f"{first['first']:.1f} s, a second call {first['second']:.1f} s (maze).\n"
    )


def solve_bodies(results: dict[str, Any]) -> str:
    """The same of the rectangle and the arm, beside their grids."""
    shares = {"mean": "mean difference", "largest": "largest", "gap": "upper - lower", "with_upper": "upper bound"}
    parts = [
        f"Errors and gaps are shares of the mean cost-to-go. Ours are measured at {results['points']:,} random free "
        "configurations with a path to the goal, roadmaps at their samples. The rectangle's grid has 48 "
        "directions in the plane: in the open and without turns, its paths are up to 0.76 % too long, elsewhere "
        "they may be longer. All methods use the same collision tests."
    ]
    for name, grid in results["grids"].items():
        sizes, half = (" x ".join(map(str, grid[which])) for which in ("sizes", "half"))
        parts.append(
            f"The grid of the {name} has {sizes} cells and takes {grid['seconds']:.0f} s; a grid of {half} cells "
            f"differs by {grid['difference']:.2%}. {grid['reached']:.1%} of free configurations have a path."
        )
    return _solved("body", results["rows"], **shares) + f"\n{' '.join(parts)}\n"


def solve_speed(results: dict[str, Any]) -> str:
    """Travel times where the speed differs from place to place, beside fast marching."""
    shares = {"mean": "mean error", "largest": "largest", "gap": "upper - lower", "without_upper": "no upper"}
    shares |= {"beyond_share": "grid beyond bounds", "beyond_largest": "by at most"}
    side = results["side"]
    table = formatted(
        (row | {name: or_dash(row[name], ".3%") for name in shares} for row in results["rows"]),
        *(("speed", "{map}"), ("cells", "{cells:,}"), ("bytes", "{bytes:,}"), ("s", "{seconds:.2f}")),
        *((head, f"{{{name}}}") for name, head in shares.items()),
        *(("grid: s", "{marching_seconds:.1f}"), ("grid: own error", "{marching_difference:.3%}")),
    )
    return table + (
        f"\nErrors and gaps are shares of the mean travel time at {results['points']:,} points. The reference "
        "is fast "
        f"marching on {side:,} x {side:,} cells; its own error is the mean difference to {side // 2:,} x "
        f"{side // 2:,} cells. Our bounds are proven for the exact times, not for the grid's.\n"
    )


def volumes(results: dict[str, Any]) -> str:
    """Errors, bounds and time in volumes of voxels, beside scikit-fmm and paths of 26 moves."""
    table = [["volume", "method", "bytes", "CPU s", "ns a point", "mean error", "upper - lower", "no upper"]]
    for row in results["rows"]:
        made = [f"{row['bytes']:,}", f"{row['seconds']:.2g}", f"{row['ns a query']:.2g}", f"{row['error']:.1%}"]
        bounds = [f"{row['gap']:.1%}", f"{1 - row['upper known']:.0%}"] if row["certified"] else ["-", "-"]
        table.append([row["volume"], f"solve_eikonal, certified={row['certified']}", *made, *bounds])
    for rival in results["rivals"]:
        made = [f"{8 * rival['its nodes']:,}", f"{rival['its seconds']:.2g}", "-", f"{rival['scikit-fmm']:.1%}"]
        table.append([rival["volume"], "scikit-fmm", *made, "-", "-"])
        table.append([rival["volume"], "26 moves", *["-"] * 3, f"{rival['26 moves']:.1%}", "-", "-"])
    broken = sum(row.get("broken", 0) for row in results["rows"])
    return markdown(table, numbers=6) + (
        "\nErrors and gaps are shares of the mean length of paths pulled taut at any angle, from "
        f"{results['rows'][0]['points']:,} points a volume. Bounds broken: {broken}.\n"
    )


def solve_cars(results: dict[str, Any]) -> str:
    """Lengths of cars' paths by closed forms, by PLRs and by tables."""
    table = formatted(
        (row | {"share": row["mean"] / row["mean_distance"]} for row in results["rows"]),
        *(("car", "{car}"), ("method", "{method}"), ("bytes", "{bytes:,}"), ("built in s", "{seconds:.1f}")),
        *(("mean error", "{mean:.2g}"), ("of distance", "{share:.3%}"), ("largest", "{largest:.2g}")),
        *((f"ns a pose of {n:,}", f"{{nanoseconds[{at}]:,.3g}}") for at, n in enumerate(results["batches"])),
        words=2,
    )
    return table + (
        f"\nErrors are in turning radii, over {results['poses']:,} random poses in a window of 50 x 50 turning radii "
        "and all headings. The table stores float32 numbers for half of the window, with cells of an eighth of a "
        "turning radius and 5 degrees; planners read the nearest cell. PLRs are compiled, in float32; closed forms "
        "and tables run in NumPy, in float64.\n"
    )


def solve_nodes(results: dict[str, Any]) -> str:
    """What heuristics with turns are worth to best-first search."""
    table = [["heuristic", "built in s", "at the start", "solved", "nodes", "s", "cost"]]
    for row in results["rows"]:
        solved = sum(cost is not None for cost in row["cost"])
        made = [f"{row['built']:.2f}", or_dash(row["at_start"], ".3f"), f"{solved}/{len(row['cost'])}"]
        runs = [spread(row["nodes"], ",.0f"), spread(row["seconds"], ".3f"), spread(row["cost"], ".3f")]
        table.append([row["heuristic"], *made, *runs])
    return markdown(table, numbers=6) + (
        f"\nOnly the best-first search of `bl_plan` runs, in the tangle. Medians, and in brackets the largest, of "
        f"{results['starts']} starts. SE(2) heuristics have {results['max_leaves']:,} cells a rectangle.\n"
    )


def summaries(results: dict[str, Any]) -> str:
    """Bytes, errors and nanoseconds of every rival on every map."""
    rows = []
    for part in results.values():
        for row in part["rows"]:
            scale, listed = row["mean"] / row["share"], row.get("published", {})
            rows.append(
                {**row, "map": part["map"], "rival": _RIVALS[part["rival"]], "mark": "" if part["compiled"] else "*"}
                | {error: row[error] / scale for error in ("mean", "largest")}
                | {"build": f"{row['build']:,.2g}" if row["build"] < 10 else f"{row['build']:,.0f}"}
                | {f"published_{which}": or_dash(listed.get(which), ".2%") for which in ("mean", "max")}
            )
    limits = ", ".join(f"{name} {n:,}" for name, n in MAX_BYTES.items() if name in {row["map"] for row in rows})
    pairs, slow = (f(row["pairs"] for row in rows) for f in (max, min))
    table = formatted(
        rows,
        *(("map", "{map}"), ("rival", "{rival}"), ("setting", "{setting}"), ("bytes", "{bytes:,}")),
        *(("mean error", "{mean:.2g}"), ("largest", "{largest:.2g}"), ("below", "{below:.1%}")),
        *(("above", "{above:.1%}"), ("ns a pair", "{nanoseconds:,.0f}{mark}"), ("s", "{build}")),
        *(("published: mean", "{published_mean}"), ("largest", "{published_max}")),
        words=3,
    )
    return table + (
        f"\nLimits of bytes: {limits}. Errors are shares of the mean distance of the same {pairs:,} random "
        f"free pairs, in rows with * of the first {slow:,}. "
        f"Below and above: pairs whose answer is too small or too large by more than {TOLERANCE:.0e} of that mean. "
        f"ns a pair: warm, all pairs in one call; *: not compiled as a whole, these {slow:,} pairs. "
        "s: seconds from workspace to file, for all settings that were tried. "
        "Published: relative errors of the 160 published lengths of the arena.\n"
    )


def families(results: dict[str, Any]) -> str:
    """Seconds and errors of PLRs of a thousand goals, beside those that are built alone."""
    stack = results["stack"]
    table = formatted(
        (
            row | {"ms": 1e3 * row["seconds"] / row["goals"], "ms_alone": 1e3 * row["cpu_alone"]}
            for row in results["rows"]
        ),
        *(("map", "{map}"), ("goals", "{goals:,}"), ("at most bytes", "{bytes:,}"), ("seconds", "{seconds:.1f}")),
        *(("ms a goal", "{ms:.1f}"), ("CPU ms alone", "{ms_alone:.0f}"), ("mean error", "{family[mean]:.2g}")),
        *(("alone", "{alone[mean]:.2g}"), ("largest", "{family[max]:.2g}"), ("alone", "{alone[max]:.2g}")),
    )
    cpu = formatted(
        (row | {"ms": 1e3 * row["cpu_a_goal"]} for row in results.get("cpu", [])),
        *(("map", "{map}"), ("corners", "{corners:,}"), ("goals", "{goals:,}"), ("at most bytes", "{bytes:,}")),
        *(("CPU ms a goal", "{ms:.1f}"), ("mean error", "{mean:.2g}"), ("largest", "{max:.2g}")),
    )
    return (
        table
        + (f"\n{cpu}" if "cpu" in results else "")
        + (
            f"\nA stack of {stack['plrs']:,} PLRs answers {stack['points']:,} pairs of a goal's index and a point in "
            f"{1e3 * stack['stack']:.1f} ms; one PLR answers as many points in {1e3 * stack['one']:.1f} ms.\n"
        )
    )


def pair_bounds(results: dict[str, Any]) -> str:
    """Bounds of pairs: how many are broken, and how wide they are."""
    return formatted(
        (row | {"megabytes": row["resident_bytes"] / 1e6} for row in results["rows"]),
        *(("map", "{map}"), ("bytes", "{bytes:,}"), ("MB in memory", "{megabytes:.2g}")),
        *(("s to build", "{build_seconds:.2g}"), ("pairs", "{pairs:,}"), ("bounds violated", "{violations:,}")),
        *(("mean error", "{error:.2g}"), ("largest", "{largest:.2g}"), ("mean gap below", "{gap:.2g}")),
        *(("above", "{gap_above:.2g}"), ("has an upper bound", "{told:.3%}"), ("ns a pair", "{nanoseconds:,.0f}")),
        ("ns of bounds", "{nanoseconds_of_bounds:,.0f}"),
    )


def fleets(results: dict[str, Any]) -> str:
    """Pairs of large grids: what they take, how fast they answer, and how many answers are wrong."""
    return formatted(
        (
            row
            | {
                "megabytes": row["resident_bytes"] / 1e6,
                "pairs": row["random_pairs"] + row["near_pairs"],
                "window_ms": 1e3 * row["window_cpu_seconds"],
                "two_core_ms": 1e3 * row["window_seconds"],
            }
            for row in results["rows"]
        ),
        *(("map", "{map}"), ("neighbors", "{connectivity}"), ("cells", "{cells:,}"), ("corners", "{corners:,}")),
        *(("s to build", "{build_cpu_seconds:.2g}"), ("peak GB", "{peak_gigabytes_of_process:.2g}")),
        *(("bytes of the file", "{file_bytes:,}"), ("MB in memory", "{megabytes:.3g}")),
        *(("10,000 tables of 4 bytes a cell / memory", "{tables_over_ours:,.0f}"), ("pairs", "{pairs:,}")),
        *(("wrong", "{wrong:,}"), ("ns a pair", "{cpu_nanoseconds:,.0f}"), ("in C", "{c_nanoseconds:,.0f}")),
        *(("ms of 10,000 windows", "{window_ms:,.0f}"), ("by two cores", "{two_core_ms:,.0f}")),
    )
