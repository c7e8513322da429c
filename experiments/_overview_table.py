"""The first table of experiments/README.md: each question, our answer, the best rival's answer, and who wins."""

from statistics import median
from typing import Any

from experiments._distance_tables import cones_and_best_rival
from experiments._tables import markdown, scenes_by_winner, two_digits

_MAP = "den312d"  # the map of single numbers: medium size, not made by us
_BYTES = 6_144


def overview(
    benchmark: dict[str, Any],
    summaries: dict[str, Any],
    costs: dict[str, Any],
    living: dict[str, Any],
    jit: dict[str, Any],
    race: dict[str, Any],
) -> str:
    """Return one row for each comparison with other tools, with a link to its section or results file."""
    cones, error, other = cones_and_best_rival(benchmark["accuracy"], _MAP, _BYTES)
    nanoseconds = {name: each["1000000"][0] for name, each in benchmark["query"]["plane"]["nanoseconds"].items()}
    faster = nanoseconds["grid, JAX"] / nanoseconds["PLR, planes"]
    oracle = benchmark["oracle"]["maps"][_MAP]
    rival = oracle["rivals"]["extremitypathfinder"]
    prepare = oracle["seconds_workspace"] + oracle["seconds_prepare"]
    query, alone = min(oracle["microseconds_a_point"].values()), oracle["microseconds_a_point"]["1"]
    pairs, polygon, network = (
        summaries[f"{_MAP}_{name}"]["rows"][-1] for name in ("ours", "polygon", "landmark_plrs")
    )
    estimates, equal = costs["estimates"]["rows"], costs["equal_seconds"]["rows"]
    better = [
        sum(row["error"] + row["of the truth"] < row[theirs] for row in equal)
        for theirs in ("its error", "its error, extrapolated")
    ]
    ratios = [row["error"] / row["its error"] for row in estimates]
    slower = median(row["seconds"] / row["its seconds"] for row in estimates)
    changes = {row["by"]: row for row in living["rivals"]["rows"]}
    levels = {row["what"]: row["levels_a_cpu_second"] for row in jit["11 x 11"]["rows"]}
    races = race["summary"]
    known, new, same = (
        {who: len(names) for who, names in scenes_by_winner(races, mark, key).items()}
        for mark, key in (("first_path", "sooner"), ("first_path", "sooner_on_new_map"), ("same_cost", "sooner"))
    )
    rows = [
        ["question", "ours", "best of the others", "result", "details"],
        [
            f"mean error of a file of {_BYTES:,} bytes, {_MAP}",
            f"cones {cones:.2g}",
            f"{other} {error:.2g}",
            f"**ours**, {two_digits(error / cones)} times smaller",
            "[errors](#errors)",
        ],
        [
            "time a point, batch of 1,000,000, equal bytes",
            f"planes {nanoseconds['PLR, planes']:.2g} ns",
            f"grid in JAX {nanoseconds['grid, JAX']:.2g} ns",
            f"**ours**, {faster:.2f} times faster" if faster > 1 else f"grid in JAX, {1 / faster:.2f} times faster",
            "[time](#time)",
        ],
        [
            f"exact distances, {_MAP}: preparation; one point",
            f"{prepare:.2g} s; {alone:,.0f} us alone, {query:.2g} us in a batch",
            f"extremitypathfinder {rival['prepare']:.2g} s; {1e6 * rival['query']:,.0f} us",
            f"**ours**, {rival['prepare'] / prepare:.0f} and {two_digits(1e6 * rival['query'] / alone)} times faster",
            "[time](#time)",
        ],
        [
            f"distance of any two points, {_MAP}",
            f"{pairs['bytes']:,} bytes, {pairs['mean']:.1g}, {pairs['nanoseconds']:,.0f} ns",
            f"polygons and exact search {polygon['bytes']:,} bytes, exact, {polygon['nanoseconds']:,.0f} ns; "
            f"best approximation {network['mean']:.1g}, {network['nanoseconds']:,.0f} ns",
            "**ours** in time among exact ones; polygons in bytes; coarser approximations in time",
            "[all pairs](#all-pairs)",
        ],
        [
            f"costs that vary, {len({row['map'] for row in estimates})} fields: mean error of about as many "
            "leaves as nodes",
            "1",
            f"scikit-fmm {1 / max(ratios):.1f} to {1 / min(ratios):.0f}",
            f"**ours** for each stored number, by a finer march; scikit-fmm in time, {two_digits(slower)} times. In "
            f"equal CPU seconds, **ours** with 8 KB on {better[0]} fields, on {better[1]} if its marches are "
            "extrapolated",
            "[costs.json](results/costs.json)",
        ],
        [
            "distances after a map change, den520d",
            f"any point, exact: {changes['with_workspace']['ms']:.0f} ms after the workspace's own change; "
            f"a new file, proven: {changes['built anew']['ms']:,.0f} ms",
            f"D\\* Lite, one path: {changes['D* Lite']['ms']:.0f} ms; "
            f"scikit-fmm, all cells: {changes['scikit-fmm']['ms']:.1f} ms",
            "about equal for one path; scikit-fmm for cells; **ours** for any point",
            "[living.json](results/living.json)",
        ],
        [
            "4-connected distances inside `jit`, levels of 11 x 11 cells a CPU second",
            f"to one goal {levels['moves=4, all cells']:,.0f}; all pairs "
            f"{levels['moves=4, all pairs of cells']:,.0f}",
            f"JaxNav, one pair {levels['JaxNav dikstra_path, one pair']:,.0f}; "
            f"jaxgmg, all pairs {levels['jaxgmg maze_distances, all pairs']:,.0f}",
            f"**ours**, {levels['moves=4, all cells'] / levels['JaxNav dikstra_path, one pair']:.0f} and "
            f"{levels['moves=4, all pairs of cells'] / levels['jaxgmg maze_distances, all pairs']:.0f} times faster",
            "[inside jit](#inside-jit)",
        ],
        [
            f"first path of a team, {len(races)} scenes that we tuned on",
            f"sooner in {known['ours']} on known maps, in {new['ours']} on new maps",
            f"OMPL sooner in {known['OMPL']} on known maps, in {new['OMPL']} on new maps; the others are ties",
            f"known maps: {_leader(known)}; new maps: {_leader(new)}",
            "[planning](#planning)",
        ],
        [
            "time to a path that costs no more than ours, known maps",
            f"sooner in {same['ours']} of {len(races)} scenes",
            f"OMPL sooner in {same['OMPL']}",
            _leader(same),
            "[planning](#planning)",
        ],
    ]
    return markdown(rows, numbers=0)


def _leader(scenes: dict[str, int]) -> str:
    return "**ours**" if scenes["ours"] > scenes["OMPL"] else "OMPL" if scenes["OMPL"] > scenes["ours"] else "a tie"
