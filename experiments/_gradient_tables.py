"""The README's tables on gradients: what continuity costs, where gradients lead, what optimization gains."""

from typing import Any

from experiments._tables import markdown

_SHOWN = 6_144  # bytes; the results have other sizes too


def continuity(results: dict[str, Any]) -> str:
    """The kinds of leaves at equal bytes: error, jumps, and what they cost."""
    rows = [["map", "leaf", "leaves", "mean error", "largest jump", "of the gradient", "ns a point", "built in s"]]
    for row in results["rows"]:
        if row["budget"] == _SHOWN:
            rows.append(
                [
                    row["map"],
                    row["leaf"],
                    f"{row['leaves']:,}",
                    f"{row['mean']:.2g} ({row['max']:.2g})",
                    f"{row['value_jump']:.1g}",
                    f"{row['gradient_jump']:.1g}",
                    f"{row['nanoseconds']:.1f} ({row['to_planes']:.1f} x)",
                    f"{row['seconds']:.1f}",
                ]
            )
    slowest = {row["leaf"]: 0.0 for row in results["rows"]}
    for row in results["rows"]:
        slowest[row["leaf"]] = max(slowest[row["leaf"]], row["to_planes"])
    sizes = sorted({row["budget"] for row in results["rows"]})
    note = (
        f"At {_SHOWN:,} bytes. In brackets the largest error, and the multiple of the time of planes, which from "
        f"{sizes[0]:,} to {sizes[-1]:,} bytes is at most {slowest['continuous']:.1f} for continuous and "
        f"{slowest['smooth']:.1f} for smooth leaves. Jumps are over faces that one can step across, of the value as "
        "a share of the largest distance."
    )
    return markdown(rows, numbers=6) + f"\n{note}\n"


def descent(results: dict[str, Any]) -> str:
    """Where gradients point, where they lead alone, and where descent does."""
    head = ["angle", "raw gradient reaches", "descent reaches", "crosses a wall", "length / exact", "s"]
    rows = [["map", "leaf", *head]]
    for each in results["maps"]:
        for row in each["rows"]:
            if row["budget"] == _SHOWN:
                angles, ratio = row["gradient"]["angles"], row["ratio"]
                rows.append(
                    [
                        each["map"],
                        row["leaf"],
                        f"{angles['0.5']:.2g} ({angles['0.99']:.2g})",
                        f"{row['walks']['reached']:.1%}",
                        f"{row['reached']:.2%}",
                        f"{row['crossings']}",
                        f"{ratio['median']:.4f} ({ratio['max']:.4f})",
                        f"{row['seconds']['median']:.2f}",
                    ]
                )
    blind = ", ".join(
        f"{each['map']} {each['without_field']['reached']:.2%}, {each['without_field']['ratio']['max']:.4f}"
        for each in results["maps"]
    )
    rows_of_all = [row for each in results["maps"] for row in each["rows"]]
    not_finite, zero = (sum(row["gradient"][f"num_{what}"] for row in rows_of_all) for what in ("not_finite", "zero"))
    worst = max(row["finite_differences"] for row in rows_of_all)
    note = (
        f"From {results['starts']:,} random starts, fields of {_SHOWN:,} bytes. Angles to the exact direction in "
        "degrees: median, and in brackets 99 %. Lengths: median, and in brackets the largest. With a field of zeros, "
        f"starts that reach the goal, and the largest length: {blind}. Of {results['points']:,} free "
        f"points a field, over all sizes, {not_finite} have no finite gradient and {zero} a zero one outside cells "
        f"that hold the goal. Inside cells, gradients are finite differences to {worst:.0e} of their length."
    )
    return markdown(rows, numbers=len(head)) + f"\n{note}\n"


def trajectory(results: dict[str, Any]) -> str:
    """What optimization makes of BL's paths."""
    rows = [["scene", "BL / bound", "optimized / bound", "valid, ends exact", "BL s", "optimized in s"]]
    for row in results["rows"]:
        rows.append(
            [
                row["scene"],
                *(f"{row['cost_over_bound'][when]:.4f}" for when in ("before", "after")),
                "yes" if row["valid"] and row["ends_exact"] else "no",
                f"{row['seconds_plan']:.2f}",
                f"{row['seconds']:.1f}",
            ]
        )
    return markdown(rows, numbers=5) + (
        "\nBound: the sum of the robots' exact distances, each alone, without turns. Seconds without compilation.\n"
    )


def placement(results: dict[str, Any]) -> str:
    """What placements cost, and what rivals cost more."""
    head = ["map", "facilities for points", "least", "cost", "best points", "dense grid", "straight lines", "s"]
    rows = [head]
    for row in results["rows"]:
        more = [
            "-" if row[rival] is None else f"{row[rival] / row['cost'] - 1:+.2%}"
            for rival in ("of_points", "of_grid", "straight")
        ]
        served = f"{row['k']} for {row['n']:,}"
        cells = [row["map"], served, row["objective"], f"{row['cost']:,.5g}", *more, f"{row['seconds']:.2g}"]
        rows.append(cells)
    error = max(abs(row["said"] / row["cost"] - 1) for row in results["rows"])
    return markdown(rows, numbers=5) + (
        "\nExact costs, and by how much the rivals' are above. Best points: the best demand point of all; of some, "
        "what exchanges from 8 random choices lead to at best, by a table of all exact distances. Seconds without "
        f"compilation and without building the pairs. Costs by the pairs are exact to {error:.0e}. Facilities in "
        f"obstacles: {sum(not row['free'] for row in results['rows'])}.\n"
    )


def refinement(results: dict[str, Any]) -> str:
    """What losses and penalties make of the planes of one partition."""
    rows = [["planes", "mean error", "largest", "too long in", "too long by at most", "rms of &#124;grad&#124; - 1"]]
    largest = max(row["budget"] for row in results["rows"])
    for row in results["rows"]:
        if row["scene"] == "maze" and row["budget"] == largest:
            rows.append(
                [
                    row["planes"],
                    *(f"{row[name]:.2g}" for name in ("mean", "max")),
                    f"{row['over']:.2%}",
                    *(f"{row[name]:.2g}" for name in ("max_over", "eikonal_rms")),
                ]
            )
    return markdown(rows, numbers=5) + (
        f"\nThe maze, {largest:,} bytes, fitted to {results['training_points']:,} points, measured at "
        f'{results["test_points"]:,} others. "lowered": the constructed planes less a constant.\n'
    )
