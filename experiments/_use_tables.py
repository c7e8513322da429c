"""Tables of README files about what distances are used for: planning, paths, files on their way."""

import itertools
from typing import Any

import numpy as np

from experiments._tables import formatted, in_time, markdown, nodes_of, or_dash, scenes_by_winner, spread, verdict

_IN_BETWEEN = "four rooms 2", "four rooms 3", "cross 2", "crowd 25"
"""Scenes whose smaller and larger siblings say as much; they are in the tables of all results."""
_IN_PAPER = "none", "plr", "rrt_star"
_SHOWN = 6_144  # bytes; the results have other sizes too


def planning(results: dict[str, Any], race: dict[str, Any]) -> str:
    """Seconds and costs of ``bl_plan``, the paper's seconds, and those of the best of OMPL."""
    table = [["scene", "paper, s", "`bl_plan`, s", "on a new map, s", "cost / bound", "OMPL to our cost, s"]]
    rows = {row["scene"]: row for row in results["rows"] if row["heuristic"] == "lattice"}
    for total in race["summary"]:
        if (name := total["scene"]) in _IN_BETWEEN:
            continue
        trials, same = [trial for trial in race["trials"] if trial["scene"] == name], total["same_cost"]
        row = rows.get(name) or {
            "seconds": [trial["ours"]["known_map"]["same_cost"] for trial in trials],
            "cost_over_bound": [trial["ours"]["cost"] / trial["lower_bound"] for trial in trials],
        }
        cells = [f"{results['paper'].get(name, {'plr': '-'})['plr'][0]}", spread(row["seconds"], ".2f")]
        cells += [f"{same['new_map']:.2f}", spread(row["cost_over_bound"], ".3f")]
        table.append([name, *cells, in_time(same["best"])])
    winners = [scenes_by_winner(race["summary"], "first_path", key) for key in ("sooner", "sooner_on_new_map")]
    first = "`bl_plan` was sooner in {}, OMPL in {}; on new maps, `bl_plan` in {}, OMPL in {}"
    first = first.format(*(len(each[who]) for each in winners for who in ("ours", "OMPL")))
    return markdown(table, numbers=5) + (
        f"\nMedians (worst) of {len(race['seeds'])} variants. OMPL: seconds until a planner reaches our cost, or in "
        f"how many variants one does, within {race['limit']['least']:g} s or {race['limit']['factor']:g} times our "
        f"time. First path in {len(race['summary'])} scenes: {first} (sign test, 5 %).\n"
    )


def table2(results: dict[str, Any]) -> str:
    """Table II: seconds and samples in the paper, then of BL without and with PLRs, of RRT*, and of ``bl_plan``."""
    runs = {(row["scene"], row["heuristic"]): row for row in results["rows"]}
    head = ["scene", "paper: BL", "paper: BL, PLR", "paper: RRT*", "BL s", "BL, PLR: s", "samples", "cost / bound"]
    first = "first_path_seconds"
    table = [[*head, "RRT*: first path s", "as BL, PLR s", "samples", "`bl_plan` s", "cost / bound"]]

    for name in dict.fromkeys(scene for scene, _ in runs):
        blind, plr, rrt_star, ours = (runs[name, each] for each in ("none", "PLR, point robots", "RRT*", "lattice"))
        paper = results["paper"].get(name, {})
        cells = [name, *("{} s ({:,})".format(*cell) if (cell := paper.get(key)) else "-" for key in _IN_PAPER)]
        cells += [in_time(blind[first]), in_time(plr[first]), f"{np.median(plr['nodes']):,.0f}"]
        cells += [f"{np.median(np.divide(plr['first_path_cost'], plr['lower_bound'])):.3f}"]
        cells += [in_time(rrt_star[first]), in_time(rrt_star["seconds"]), f"{np.median(rrt_star['nodes']):,.0f}"]
        table.append([*cells, *(spread(ours[key], ".3f") for key in ("seconds", "cost_over_bound"))])
    shares = [share for row in results["rows"] for share in row.get("python_share", [])]
    return markdown(table, numbers=len(table[0]) - 1) + (
        f"\nMedians, and in brackets the worst, of {len(results['seeds'])} variants for `bl_plan`, "
        f"{results['starts_under_heuristics']} for BL with PLRs, {results['starts_few']} for RRT* and BL "
        f"without. Limits: {results['seconds_none']:g} s for BL without PLRs, "
        f"{results['seconds_rrt_star']:g} s for RRT*. Calls of Python are {min(shares):.0%} to {max(shares):.0%} of "
        f"RRT*'s time. Each PLR has at most {results['plr_bytes']:,} bytes.\n"
    )


def heuristics(results: dict[str, Any]) -> str:
    """Nodes under every heuristic, scene by scene."""
    searches = [row for row in results["rows"] if row["heuristic"] != "RRT*"]
    names = list(dict.fromkeys(row["heuristic"] for row in searches))
    rows = [["nodes", *names]]
    for scene in dict.fromkeys(row["scene"] for row in searches):
        rows.append([scene, *(nodes_of(row) for row in searches if row["scene"] == scene)])
    return markdown(rows, numbers=len(names))


def race(results: dict[str, Any]) -> str:
    """Our seconds and those of OMPL's best planner, to any path, to 5 % more than ours in the end, and to no more."""
    marks = {"first_path": "first", "cost_5_percent_more": "5 % more", "same_cost": "same cost"}
    summaries, limit = results["summary"], results["limit"]
    rows = []
    for total, (mark, name) in itertools.product(summaries, marks.items()):
        row = {key: in_time(total[mark][key]) for key in ("best", "without_python")}
        rows.append({**total[mark], **row, "scene": total["scene"], "path": name})
    table = formatted(
        rows,
        *(("scene", "{scene}"), ("path", "{path}"), ("ours s", "{ours:.2g}"), ("on a new map s", "{new_map:.2g}")),
        *(("best of OMPL s", "{best}"), ("without Python s", "{without_python}"), ("ours sooner", "{sooner}")),
        *(("on a new map", "{sooner_on_new_map}"), ("than without Python", "{sooner_than_without_python}")),
        words=2,
    )
    attempts = [attempt for trial in results["trials"] for attempt in trial["ompl"].items()]
    shares = {name: [each["python_share"] for planner, each in attempts if planner == name] for name, _ in attempts}
    python = ", ".join(f"{name} {min(each):.0%} to {max(each):.0%}" for name, each in shares.items())
    return table + (
        f"\nMedians over {len(results['seeds'])} starts. Limit: {limit['least']:g} s, or {limit['factor']:g} times "
        f"our time if that is more. Calls of Python, share of a trial's time: {python}. First path, sooner: "
        f"{verdict(summaries, 'first_path')}; than OMPL without Python: "
        f"{verdict(summaries, 'first_path', 'sooner_than_without_python')}; on a new map: "
        f"{verdict(summaries, 'first_path', 'sooner_on_new_map')}. Same cost: {verdict(summaries, 'same_cost')}.\n"
    )


def sba_star(results: dict[str, Any]) -> str:
    """Vertices, seconds and costs of SBA*'s first path under each heuristic."""
    table = formatted(
        (
            row
            | {"p": row["p_value"], "s": np.median(row["seconds"]), "vertices": spread(row["vertices"], ",.0f")}
            | {"cost": spread(row["cost_over_bound"], ".2f"), "solved": sum(map(bool, row["valid"]))}
            for row in results["rows"]
        ),
        *(("scene", "{scene}"), ("heuristic", "{heuristic}"), ("solved", "{solved}"), ("vertices", "{vertices}")),
        *(("p", "{p:.2g}"), ("s", "{s:.2g}"), ("cost / bound", "{cost}")),
        words=2,
    )
    return table + (
        f"\nMedians (largest) over {results['seeds']} seeds, to the first path or {results['max_vertices']:,} "
        f"vertices. Each PLR has at most {results['plr_bytes']:,} bytes.\n"
    )


def teams(results: dict[str, Any]) -> str:
    """Teams: the first path, what the call returns, and what half a minute makes of it."""
    forms = {"first": ".3f", "first_ratio": ".3f", "seconds": ".3f", "ratio": ".4f"}
    rows = [["team", "robots", "no path", "first path s", "its cost / bound", "s", "cost / bound"]]
    for section in results.values():
        limit = section.get("time_limit")
        for row in section["rows"]:
            name, largest = (
                f"{row['scene']}, improved for up to {limit:g} s" if limit else row["scene"],
                row.get("largest", {}),
            )
            cells = [f"{row['robots']}", f"{row['failures']}/{row['runs']}"]
            for key, form in forms.items():
                worst = f" ({largest[key]:{form}})" if largest.get(key) is not None else ""
                cells.append(or_dash(row[key], form) + worst)
            rows.append([name, *cells])
    return markdown(rows, numbers=6) + (
        "\nMedians of several teams, and in brackets the largest. No path: calls that found no path. Bound: the sum "
        "of the exact distances of the robots, each alone; in den520d, the distances of points.\n"
    )


def descent(results: dict[str, Any]) -> str:
    """Render how many paths of descent reach the goal, and how long they are."""
    rows = [row | {"map": each["map"]} for each in results["maps"] for row in each["rows"]]
    table = formatted(
        (row for row in rows if row["budget"] == _SHOWN),
        *(("map", "{map}"), ("leaf", "{leaf}"), ("reach the goal", "{reached:.2%}")),
        *(("crosses a wall", "{crossings}"), ("length / exact", "{ratio[median]:.4f} ({ratio[max]:.4f})")),
        ("s", "{seconds[median]:.2f}"),
        words=2,
    )
    blind = ", ".join(
        f"{each['map']} {each['without_field']['reached']:.2%}, {each['without_field']['ratio']['max']:.4f}"
        for each in results["maps"]
    )
    return table + (
        f"\n{results['starts']:,} random starts; fields of {_SHOWN:,} bytes. Lengths are medians, and in "
        "brackets the "
        "largest. For comparison, a field of zeros: share of starts that reach the goal, and largest length: "
        f"{blind}.\n"
    )


def pictures(results: dict[str, Any]) -> str:
    """From a picture to a file: seconds, vertices, how near the polygons are, errors."""
    return formatted(
        results["rows"],
        *(("picture", "{map}"), ("pixels", "{pixels[1]} x {pixels[0]}"), ("read s", "{seconds_read:.2g}")),
        *(("vertices", "{vertices:,}"), ("pixels apart", "{hausdorff:.3f}")),
        ("passages closed", "{closed_passages} of {passages:,}"),
        *(("build s", "{best[seconds]:.1f}"), ("of processors", "{best[cpu_seconds]:.1f}")),
        *(("planes alone s", "{plane[seconds]:.1f}"), ("mean error", "{mean_error:.2g} of {mean_distance:.3g}")),
        words=2,
    )


def readers(results: dict[str, Any]) -> str:
    """What code and numbers take in C, and what a point costs in C and in NumPy."""
    table = formatted(
        (row | {"equal": min(row["c_equal"], row["jax_equal"])} for row in results["readers"]["rows"]),
        *(("PLR", "{plr}"), ("leaves", "{leaves:,}"), ("file", "{bytes:,}"), ("code", "{code:,}")),
        *(("numbers", "{data:,}"), ("C ns", "{c_nanoseconds:.0f}"), ("NumPy us", "{numpy_microseconds:.1f}")),
        *(("NumPy, many, ns", "{numpy_batch_nanoseconds:.0f}"), ("equal bits", "{equal:.0%}")),
    )
    largest = max(results["query"]["rows"], key=lambda row: row["rows"])
    return table + (
        f"\nSizes are in bytes; code is compiled with `-Os` for x86-64. Equal bits: share of "
        f"{results['readers']['points']:,} answers that are equal in C, NumPy and `plr(x)`. "
        f"`plr-jax query` answers {largest['rows']:,} rows of text in "
        f"{largest['seconds']:.1f} s and {largest['megabytes']:.0f} MB.\n"
    )


def small_machines(results: dict[str, Any]) -> str:
    """Bytes of compiled C headers, those of quick tables beside compact ones."""
    table = formatted(
        (row | {"header": "compact" if row["compact"] else "quick tables"} for row in results["rows"]),
        *(("map", "{map}"), ("leaf", "{leaf}"), ("header", "{header}"), ("file", "{bytes:,}"), ("code", "{code:,}")),
        *(("data", "{data:,}"), ("stack", "{stack:,}"), ("ns a point", "{nanoseconds:,.0f}")),
        ("equal bits", "{equal:.0%}"),
        words=3,
    )
    return f"{table}\nSizes are in bytes, compiled with `-Os` for x86-64. No header uses other memory.\n"


def modules(results: dict[str, Any]) -> str:
    """What modules of JavaScript answer, and what that costs."""
    table = formatted(
        results["bits"]["rows"],
        *(("JavaScript", "{what}"), ("file", "{file:,}"), ("text", "{text:,}"), ("different", "{different}")),
        ("ns", "{nanoseconds:.0f}"),
    )
    points = f"{results['bits']['points']:,}"
    return f"{table}\nSizes are in bytes. Different: answers of {points} in Node that differ from NumPy's answers.\n"


def pages(results: dict[str, Any]) -> str:
    """Pages in Chromium: size, speed, and what damaged files and a check of accessibility come to."""
    rows, hostile = results["pages"]["rows"], results["hostile"]
    found = ("-" if row["violations"] is None else len(row["violations"]) for row in rows)
    table = formatted(
        (row | {"millions": row["queries_a_second"] / 1e6, "found": n} for row, n in zip(rows, found, strict=True)),
        *(("page", "{what}"), ("bytes", "{bytes:,}"), ("addresses asked for", "{requests}")),
        *(("million queries / s", "{millions:.3g}"), ("ms to draw 500 x 500", "{redraw_milliseconds:.0f}")),
        ("violations of axe-core (-: not measured)", "{found}"),
    )
    return table + (
        "\nCPU time of the page's thread in Chromium; pages of pairs are drawn again for another goal. "
        f"Of {hostile['files']:,} damaged files that were dropped on a page, {hostile['refused']:,} were "
        f"refused with a message, {hostile['shown']:,} were drawn, and {hostile['failed']} did neither; the slowest "
        f"took {hostile['most_seconds']:.2f} s.\n"
    )


def car(results: dict[str, Any]) -> str:
    """Lengths of Reeds and Shepp's paths in C, beside a table."""
    return formatted(
        results["car"]["rows"],
        *(("Reeds-Shepp in C", "{what}"), ("file", "{file:,}"), ("program", "{bytes:,}")),
        *(("mean error", "{mean:.2g}"), ("largest", "{largest:.2g}"), ("ns a query", "{nanoseconds:.0f}")),
        ("s to build", "{seconds:.1f}"),
    )


def scale(results: dict[str, Any]) -> str:
    """Who builds for a fleet, and whether the files are equal."""
    goals = results["goals"]
    table = formatted(
        (row | {"file": row["digest"][:8], "equal": "yes" if row["same"] else "no"} for row in goals["workers"]),
        *(("workers", "{kind}"), ("files", "{file}"), ("the same", "{equal}"), ("number", "{workers}")),
        ("s", "{seconds:.1f}"),
        words=3,
    )
    return table + (
        f"\nWorkers build {goals['goals']:,} goals, files of {goals['bytes']:,} bytes: of cones, or of planes if a "
        "worker is killed.\n"
    )


def shaping(learning: dict[str, Any], speed: dict[str, Any]) -> str:
    """Success of agents under each reward, when they reach the target, and what a step costs them."""
    rates = {(row["kind"], row["doing"]): row["steps_a_second"] for row in speed["rows"]}
    head = ["reward", "mazes solved", "of seeds", f"steps to {learning['target']:.0%}"]
    rows = [[*head, "steps a second, acting", "learning"]]
    for kind in dict.fromkeys(row["kind"] for row in learning["rows"]):
        runs = [row for row in learning["rows"] if row["kind"] == kind]
        final = [row["success"][-1] for row in runs]
        reached = [row["steps_to_target"] for row in runs if row["steps_to_target"] is not None]
        when = f"{np.mean(reached):,.0f}" if len(reached) == len(runs) else f"{len(reached)} of {len(runs)} get there"
        cells = [kind, f"{np.mean(final):.1%}", f"{min(final):.1%} to {max(final):.1%}", when]
        rows.append(cells + [f"{rates[kind, doing]:,.0f}" for doing in ("acting", "learning")])
    detours = learning["detours"]
    return markdown(rows, numbers=5) + (
        f"\nMeans of {len(runs)} seeds after {learning['steps'][-1]:,} steps, on {learning['mazes']} new "
        "mazes. The mean "
        f"distance to the goal is {detours['around']:.1f} cells, and {detours['straight']:.1f} cells in a straight "
        f"line; the mean ratio is {detours['mean_ratio']:.2f}.\n"
    )


def pedestrians(results: dict[str, Any], hard_points: dict[str, Any]) -> str:
    """Routes and evacuations of JuPedSim beside those of cones; cones of walkable areas, and their bounds."""
    rows, notes = [], []
    parts = [{row["map"]: row for row in results[name]["rows"]} for name in ("routes", "evacuations", "cones")]
    for name, route in parts[0].items():
        crowds, cones, took = parts[1][name], parts[2][name], route["microseconds"]
        for router, of_path in (("JuPedSim", "JuPedSim"), ("cones", "paths")):
            runs = {key: [crowd[key] for crowd in crowds[router]] for key in ("last", "mean", "stuck")}
            cells = {key: f"{np.mean(runs[key]):.1f}" for key in ("last", "mean")} | {"stuck": sum(runs["stuck"])}
            over = {f"over_{key}": f"{route[router][key]:.6f}" for key in ("mean", "largest")}
            clear = "{mean:.3f} ({largest:.3f})".format(**route[router]["over_clear"]) if router == "JuPedSim" else ""
            crosses = f"{route[router]['crosses']} of {route['pairs']}"
            crosses += f", {route[router]['deepest']:.2g} m" if route[router]["crosses"] else ""
            rows.append({"map": name, "router": router, "us": took[of_path], "crosses": crosses, **cells, **over})
            rows[-1]["clear"] = clear
        notes.append(
            f"{name}, {cones['vertices']} vertices: {np.median(cones['seconds']):.2g} CPU s (first "
            f"{cones['seconds'][0]:.2g}), mean error {cones['mean']:.1e} m, largest {cones['largest']:.2g} m, "
            f"{np.median(cones['nanoseconds']):.0f} ns a point in C; one by one in NumPy, a distance takes "
            f"{took['distance']:.2g} us, a path {took['path']:.0f} us, "
            f"a waypoint {took['waypoint']:.0f} us, in batches of "
            f"{results['routes']['agents']} {took['agents']:.2g} us; of {results['routes']['queries']:,} paths, "
            f"{route['many']['crosses']} cross walls, the longest is {route['many']['largest']:.6f} times the exact"
        )
    broken = sum(row["broken"] + row["broken of cones"] for row in hard_points["buildings"])
    asked = sum(row["pairs"] for row in hard_points["buildings"])
    table = formatted(
        rows,
        *(("map", "{map}"), ("router", "{router}"), ("length / exact", "{over_mean}"), ("largest", "{over_largest}")),
        *(("/ exact that keeps 0.2 m", "{clear}"), ("cross walls, deepest", "{crosses}"), ("us a path", "{us:.3g}")),
        *(("all left, s", "{last}"), ("mean, s", "{mean}"), ("stuck", "{stuck}")),
        words=2,
    )
    runs = next(iter(parts[1].values()))
    return table + (
        f"\nRoutes: random points that an agent can reach; JuPedSim answers one query after another, cones "
        f"{results['routes']['queries']:,} in a call. Evacuations: means of {len(runs['cones'])} "
        f"crowds of {runs['agents']} agents, to the same exits. Cones of "
        f"{results['cones']['max_bytes']:,} bytes: {'; '.join(notes)}. Bounds of pairs and of cones at {asked:,} "
        f"pairs of random points, and of points beside walls (`hard_points`): {broken} broken.\n"
    )


def buildings(exact: dict[str, Any], costs: dict[str, Any], bounds: dict[str, Any], random: dict[str, Any]) -> str:
    """Bytes, errors and seconds of a building's files, and wrong answers beside an independent search."""
    broken = {row["budget"]: row["broken"] for row in bounds["rows"]}
    table = formatted(
        [{**row, "broken": broken[row["budget"]]} for row in costs["rows"]],
        *(("budget", "{budget:,}"), ("file, bytes", "{bytes:,}"), ("CPU s", "{cpu_seconds:.1f}")),
        *(("mean error, m", "{mean:.2g}"), ("largest", "{largest:.2g}"), ("proven", "{proven:.2g}")),
        ("broken bounds", "{broken}"),
        words=0,
    )
    of_oracle, of_files, of_pairs = (random[part] for part in ("oracle", "file", "pairs"))
    wrong = sum(number for name, number in of_oracle.items() if name != "points")
    rows = exact["rows"]
    largest = max(row["largest"] for row in rows)
    goals, num = len(rows), sum(row["wrong"] for row in rows)
    return table + (
        f"\n{costs['floors']} floors, {costs['links']} links, {costs['corners']:,} corners and link ends. Errors: "
        f"{costs['points']:,} points. Bounds: {bounds['rows'][0]['points']:,} points with a path. Preparing the "
        f"building takes {costs['preparing']:.2f} CPU s, another goal {costs['another_goal']:.3f} s. The oracle "
        f"beside an independent search by Shapely and NetworkX, {goals} goals, {exact['points']:,} points each: "
        f"{num} differ by more than {exact['error']:g} m, largest difference {largest:.1e} m. "
        f"On {random['buildings']} random buildings: {wrong} wrong distances, next links and routes of oracles at "
        f"{of_oracle['points']:,} points; {of_files['bounds']} broken bounds of files at {of_files['points']:,} "
        f"points; {of_files['routes']} wrong routes of {of_files['traced']:,} from files, between walls that touch "
        f"at a link end; {of_pairs['bounds'] + of_pairs['distances']} wrong distances and bounds of "
        f"{of_pairs['points']:,} pairs.\n"
    )


def building_speed(results: dict[str, Any]) -> str:
    """Time of a query in a building: files, exact distances, NetworkX, pairs."""
    rows = [["query, floors mixed", "CPU time a point", "elapsed"]]
    names = {"exact": "exact, oracle"}
    for row in results["rows"]:
        name = names.get(row["what"], f"file of {results['bytes']:,} bytes, {row['what']}")
        rows.append(
            [f"{name}, batch of {results['batch']:,}", f"{row['cpu_ns']:,.0f} ns", f"{row['wall_ns']:,.0f} ns"]
        )
    pairs = results["pairs"]
    name = f"any two places, file of {pairs['bytes']:,} bytes, JAX"
    rows.append([name, f"{pairs['cpu_ns']:,.0f} ns", f"{pairs['wall_ns']:,.0f} ns"])
    rows.append(["exact, oracle, one by one", f"{results['exact_us']:,.0f} us", ""])
    rows.append(["exact, NetworkX and Shapely, one by one", f"{results['networkx_us']:,.0f} us", ""])
    return markdown(rows, numbers=2) + (
        f"\nNetworkX searches the oracle's visibility graph, which was built before. Pairs take "
        f"{pairs['cpu_seconds']:.1f} CPU s to build; mean error over {pairs['pairs']:,} pairs {pairs['mean']:.1e} m, "
        f"largest {pairs['largest']:.1e} m.\n"
    )
