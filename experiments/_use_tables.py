"""Tables of README files about what distances are used for: planning, paths, files on their way."""

from typing import Any

import numpy as np

from experiments._tables import at_least, formatted, markdown, nodes_of, num_solved, or_dash, spread

_IN_BETWEEN = "four rooms 2", "four rooms 3", "cross 2", "crowd 25"
"""Scenes whose smaller and larger siblings say as much; they are in the tables of all results."""
_SHOWN = 6_144  # bytes; the results have other sizes too


def planning(results: dict[str, Any], race: dict[str, Any]) -> str:
    """Seconds and costs of ``bl_plan``, the paper's seconds, and those of the best of OMPL."""
    table = [["scene", "paper, s", "`bl_plan`, s", "cost / bound", "best of OMPL, s"]]
    rows = {row["scene"]: row for row in results["rows"] if row["heuristic"] == "lattice"}
    for total in race["summary"]:
        if (name := total["scene"]) in _IN_BETWEEN:
            continue
        trials = [trial for trial in race["trials"] if trial["scene"] == name]
        row = rows.get(name) or {
            "seconds": [trial["ours"]["seconds"] for trial in trials],
            "cost_over_bound": [trial["ours"]["cost"] / trial["lower_bound"] for trial in trials],
        }
        cells = [f"{results['paper'].get(name, {}).get('plr', '-')}", spread(row["seconds"], ".2f")]
        table.append([name, *cells, spread(row["cost_over_bound"], ".3f"), at_least(total["same_cost"], "best")])
    sooner = sum(total["first_path"]["best"] < total["first_path"]["ours"] for total in race["summary"])
    first = f"In {sooner} of" if sooner else "In all"
    who = "OMPL's first path came before ours" if sooner else "our first path came before OMPL's"
    variants, starts = len(results["seeds"]), len(race["seeds"])
    return markdown(table, numbers=4) + (
        f"\nMedians (worst) of {variants} variants of each scene; {starts} of door and crowd. Paper: with its "
        "planner, on its hardware. Bound: the sum of the robots' exact distances, without turns. OMPL: the best of "
        "its planners, for the team at once or robot by robot, until its path costs no more than ours "
        f"({starts} variants). `> t`: no such path within t seconds. {first} {len(race['summary'])} scenes, on "
        f"which we tuned the planner, {who} (medians, known map); in other tight scenes or on new maps, OMPL's may "
        "come first.\n"
    )


def table2(results: dict[str, Any], race: dict[str, Any]) -> str:
    """Table II, one row a scene: the paper's seconds, ours, nodes under PLRs and under less, and the best of OMPL."""
    head = ["scene", "paper s", "s", "first path s", "cost / bound", "under PLRs: s", "cost / bound", "nodes"]
    rows = [[*head, "best of OMPL s", "times ours"]]
    runs = {(row["scene"], row["heuristic"]): row for row in results["rows"]}
    summaries = {total["scene"]: total["same_cost"] for total in race["summary"]}
    lattice = [row for row in results["rows"] if row["heuristic"] == "lattice"]
    for ours in lattice:
        name, of_plrs = ours["scene"], runs[ours["scene"], "PLR"]
        best = summaries.get(name)
        rows.append(
            [
                name,
                f"{results['paper'].get(name, {}).get('plr', '-')}",
                *(spread(ours[key], ".3f") for key in ("seconds", "first_path_seconds", "cost_over_bound")),
                *(spread(of_plrs[key], ".3f") for key in ("seconds", "cost_over_bound")),
                spread(of_plrs["nodes"], ",.0f"),
                *((at_least(best, "best"), at_least(best, "ratio")) if best else ("-", "-")),
            ]
        )
    none = results["teams_without_heuristic"]
    return markdown(rows, numbers=len(rows[0]) - 1) + (
        f"\nMedians, and in brackets the worst, of {len(results['seeds'])} perturbed starts and goals; "
        f"{sum(map(num_solved, lattice))} of {sum(len(row['seed']) for row in lattice)} were solved. Searches with a "
        f"heuristic run from {results['starts_under_heuristics']} of the starts. Each robot's PLR has "
        f"{results['plr_bytes']:,} bytes and is built before the clock starts. Searches of teams without a heuristic "
        f"run for {none['seconds']:g} s from {none['starts']} of the starts. Best of OMPL: seconds to a path that "
        f"costs no more than ours, medians over {len(race['seeds'])} of the starts; >: most trials found none within "
        "the limit. Bound: the sum of the exact distances of the robots, each alone, without turns.\n"
    )


def heuristics(results: dict[str, Any]) -> str:
    """Nodes under every heuristic, scene by scene."""
    names = list(dict.fromkeys(row["heuristic"] for row in results["rows"]))
    rows = [["nodes", *names]]
    for scene in dict.fromkeys(row["scene"] for row in results["rows"]):
        rows.append([scene, *(nodes_of(row) for row in results["rows"] if row["scene"] == scene)])
    return markdown(rows, numbers=len(names))


def race(results: dict[str, Any]) -> str:
    """Our seconds and those of OMPL's best planner, to any path, to 5 % more than ours in the end, and to no more."""
    marks = {"first_path": "first path", "cost_5_percent_more": "5 % more", "same_cost": "same cost"}
    rows = [["scene", *(f"{name}: {who}" for name in marks.values() for who in ("ours s", "best s", "times ours"))]]
    for total in results["summary"]:
        parts = [total[mark] for mark in marks]
        cells = [(f"{part['ours']:.2g}", at_least(part, "best"), at_least(part, "ratio")) for part in parts]
        rows.append([total["scene"], *(text for three in cells for text in three)])
    limit = results["limit"]
    return markdown(rows, numbers=9) + (
        f"\nMedians over {len(results['seeds'])} starts, with one trial for each planner. The limit is "
        f"{limit['least']:g} to {limit['largest']:g} s, or {limit['ours']:g} times our seconds if that is more. "
        ">: most trials found no path within the limit, and the ratio uses the limit. Same cost: our seconds run to "
        "the end of the call.\n"
    )


def teams(results: dict[str, Any]) -> str:
    """Teams: the first path, what the call returns, and what half a minute makes of it."""
    forms = {"first": ".3f", "first_ratio": ".3f", "seconds": ".3f", "ratio": ".4f"}
    rows = [["team", "robots", "no path", "first path s", "its cost / bound", "s", "cost / bound"]]
    for section in results.values():
        limit = section.get("time_limit")
        for row in section["rows"]:
            name, largest = (
                f"{row['scene']}, improved for {limit:g} s" if limit else row["scene"],
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
    slowest = hostile["most_seconds"]
    table = formatted(
        (row | {"millions": row["queries_a_second"] / 1e6, "found": len(row["violations"] or [])} for row in rows),
        *(("page", "{what}"), ("bytes", "{bytes:,}"), ("addresses asked for", "{requests}")),
        *(("million queries / s", "{millions:.3g}"), ("ms to draw 500 x 500", "{redraw_milliseconds:.0f}")),
        ("violations of axe-core", "{found}"),
    )
    return table + (
        "\nCPU time of the page's thread in Chromium; pages of pairs are drawn again for another goal. "
        f"Of {hostile['files']:,} damaged files that were dropped on a page, {hostile['refused']:,} were "
        "refused with "
        f"a message, {hostile['shown']:,} were drawn, and {hostile['failed']} did neither; the slowest took "
        f"{slowest:.2f} s.\n"
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
        f"random points and points beside walls (`hard_points`): {broken} broken.\n"
    )
