"""Tables of README files about gradients: distances among traced polygons, and PLRs that learn."""

from typing import Any

from experiments._tables import formatted, markdown


def traced_polygons(exact: dict[str, Any], differences: dict[str, Any], speed: dict[str, Any]) -> str:
    """Milliseconds of distances and gradients beside the oracle; errors of both."""
    table = formatted(
        speed["rows"],
        *(
            ("corners", "{corners}"),
            ("distances, ms", "{forward_ms:.1f}"),
            ("and gradients: both, ms", "{both_ms:.1f}"),
        ),
        ("CPU ms: distances; both", "{forward_cpu_ms:.1f}; {both_cpu_ms:.1f}"),
        ("compile both, s", "{both_compile_seconds:.1f}"),
        *(
            ("new oracle and its distances, ms", "{oracle_ms:.1f}"),
            ("its vertex gradient, ms", "{oracle_vertex_gradient_ms:.1f}"),
        ),
        ("its finite differences, ms", "{oracle_finite_differences_ms:,.0f}"),
    )
    batch, low, high = speed["vmap"], *exact["corners"]
    errors = "; ".join(
        f"in {row['bits']} bits, {row['wrong']} wrong by more than {row['allowed']:g}, largest error "
        f"{row['largest']:.1e}"
        for row in exact["rows"]
    )
    slopes = "; ".join(f"{row['largest']:.1e} in {row['bits']} bits" for row in differences["rows"])
    return table + (
        "\n1,000 points; times are the least of many calls, CPU times their mean. Finite differences: their number "
        f"of distances times the time of a new oracle. Distances of {batch['maps']:,} maps of {batch['corners']} "
        f"corners, {batch['points a map']} points each, under `vmap`: {batch['seconds']:.2f} s, and "
        f"{batch['compile_seconds']:.0f} s to compile. Errors: {exact['maps']} random maps of {low} to {high} "
        f"corners in the unit square, {exact['points']:,} points each: {errors}. Gradients by vertices, goal and "
        f"point at {differences['places']:,} random places, beside differences of the exact oracle: largest "
        f"error {slopes}, relative to the norm of the gradient; straight paths left out.\n"
    )


def gradient_uses(layout: dict[str, Any], calibrate: dict[str, Any], generate: dict[str, Any]) -> str:
    """Layouts, calibration and generated maps: what gradients gain, beside what does without them."""
    rows = [["use", "measure", "with gradients", "without"]]
    ways = {"random search": "random search", "local random search": "(1+1) evolution strategy"}
    ways |= {"finite differences": "finite differences of the oracle"}
    for each in layout["summary"]:
        gain = {way: f"{share:.2%}" for way, share in each["median_relative_gain"].items()}
        without = ", ".join(f"{name} {gain[way]}" for way, name in ways.items())
        rows.append([f"layout, {each['exits']}", "mean distance falls by", gain["gradient"], without])
    error = {name: f"{share:.2%}" for name, share in calibrate["errors"].items()}
    alone = calibrate["samples_alone"]
    without = f"network {error['network']}, samples alone ({alone}) {error[alone]}, not fitted {error['start']}"
    rows.append(["calibration", "mean error of unseen times", error["fitted"], without])
    rows.append(
        ["harder maps", "longest / first distance, median", f"{generate['ratio']['median']:.3f}", "1 (start)"]
    )
    ratio = {each["exits"]: each["over_random_search"] for each in layout["summary"]}
    over = "; ".join(
        f"{name} {one['median']:.2f} ({one['least']:.2f} to {one['largest']:.2f})" for name, one in ratio.items()
    )
    some = layout["rows"][0]
    tried = [row["random_layouts"] for row in layout["rows"]]
    best = [row["gain"]["gradient"] / row["gain"]["local random search"] for row in layout["rows"]]
    return markdown(rows, numbers=0) + (
        f"\nLayout: {layout['machines']} machines of a shop floor shift by up to {layout['shift']:g} m and turn by "
        f"up to {layout['turn_degrees']:.0f} degrees; {layout['points']:,} points; {layout['steps']} steps of Adam, "
        f"{some['seconds']:.1f} s, and as long for each rival, or one step. Medians of {layout['floors']} floors; "
        f"gain divided by that of random search, which tried {min(tried)} to {max(tried)} layouts: {over}; by that "
        f"of the evolution strategy: {min(best):.2f} to {max(best):.2f}. Calibration: a file "
        f"of exact distances, {calibrate['bytes']['fitted']:,} bytes, fitted to {calibrate['samples']:,} times with "
        f"{calibrate['noise']:.0%} noise in {calibrate['seconds']['fitted']:.0f} s; networks of "
        f"{calibrate['bytes']['network']:,} bytes, {calibrate['network_settings']} settings, in "
        f"{calibrate['seconds']['network']:.0f} s; {calibrate['unseen']:,} unseen points. Harder maps: "
        f"{generate['maps']:,} maps of {generate['obstacles']} obstacles that move by up to {generate['radius']:g}, "
        f"{generate['steps_a_second']:,.0f} steps a second of all maps together; {generate['right']:,} results "
        f"confirmed by `VisibilityGraph`.\n"
    )


def camar_distances(camar: dict[str, Any]) -> str:
    """Steps of CAMAR with distances of its agents, beside steps without them."""
    rows = [
        {**row, **{way: f"{rate:,.0f}" for way, rate in row["steps_a_cpu_second"].items()}} for row in camar["rows"]
    ]
    table = formatted(
        rows,
        *(("discs", "{discs}"), ("corners", "{corners}"), ("CAMAR alone, steps a CPU second", "{without}")),
        *(("corners found once a level", "{once a level}"), ("in every step", "{every step}")),
    )
    checked, wrong = (sum(row[key] for row in camar["rows"]) for key in ("checked", "wrong"))
    return table + (
        f"\nCAMAR {camar['camar']}, {camar['agents']} agents, distances to their goals in every step; {wrong} of "
        f"{checked:,} differ from `VisibilityGraph` by more than 1e-5 of the map's width.\n"
    )
