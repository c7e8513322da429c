"""The tables on maps from pictures, files on their way, readers at the other end and edges of the domain."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from experiments._tables import markdown


def pictures(results: dict[str, Any]) -> str:
    """From a picture to a file: seconds, vertices, how near the polygons are, errors."""
    head = ["picture", "pixels", "read s", "vertices", "pixels apart", "passages closed", "build s", "of processors"]
    table = [[*head, "planes alone s", "mean error"]]
    for row in results["rows"]:
        width, height = row["pixels"]
        table.append(
            [
                row["map"],
                f"{height} x {width}",
                f"{row['seconds_read']:.2g}",
                f"{row['vertices']:,}",
                f"{row['hausdorff']:.3f}",
                f"{row['closed_passages']} of {row['passages']:,}",
                f"{row['best']['seconds']:.1f}",
                f"{row['best']['cpu_seconds']:.1f}",
                f"{row['plane']['seconds']:.1f}",
                f"{row['mean_error']:.2g} of {row['mean_distance']:.3g}",
            ]
        )
    return markdown(table, numbers=8)


def wire(results: dict[str, Any]) -> str:
    """Bytes of progressive files beside one-shot ones of equal error, and what is fetched of a file."""
    table = [["leaf", "a part is", "parts end at byte", "bytes / one-shot"]]
    for row in results["sizes"]["rows"]:
        ends = ", ".join(f"{mark:,}" for mark in row["marks"])
        table.append([row["leaf"], f"{row['factor']} times its coarser one", ends, f"{row['ratio']:.3f}"])
    fetched = [["asked", "requests", "bytes fetched", "of", "share"]]
    for row in results["ranges"]["rows"]:
        size = [f"{row['sent']:,}", f"{row['size']:,}", f"{row['share']:.3f}"]
        fetched.append([row["part"], str(row["requests"]), *size])
    files = results["prefixes"]["rows"]
    beyond = [count for row in files for count in row["beyond"].values()]
    headers = ", ".join(f"{what} {size}" for what, size in results["sizes"]["headers"].items())
    note = (
        f"Of {len(beyond)} prefixes of {len(files)} files, of all leaves and 1 to 6 dimensions, {sum(beyond)} of "
        f"{results['prefixes']['points']:,} answers each are beyond their bounds. Header, domain and checksum: "
        f"{headers} bytes."
    )
    return f"{markdown(table, numbers=1)}\n{markdown(fetched, numbers=4)}\n{note}\n"


def readers(results: dict[str, Any]) -> str:
    """What code and numbers take in C, and what a point costs in C and in NumPy."""
    table = [["PLR", "leaves", "file", "code", "numbers", "C ns", "NumPy us", "NumPy, many, ns", "equal bits"]]
    rows = results["readers"]["rows"]
    for row in rows:
        table.append(
            [
                row["plr"],
                *(f"{row[what]:,}" for what in ("leaves", "bytes", "code", "data")),
                f"{row['c_nanoseconds']:.0f}",
                f"{row['numpy_microseconds']:.1f}",
                f"{row['numpy_batch_nanoseconds']:.0f}",
                f"{min(row['c_equal'], row['jax_equal']):.0%}",
            ]
        )
    largest = max(results["query"]["rows"], key=lambda row: row["rows"])
    note = (
        f"Bytes; code at `-Os` on x86-64. Equal bits: of {results['readers']['points']:,} answers, those of C, NumPy "
        f"and `plr(x)` that are the same. `plr-jax query` answers {largest['rows']:,} rows of text in "
        f"{largest['seconds']:.1f} s and {largest['megabytes']:.0f} MB."
    )
    return f"{markdown(table, numbers=8)}\n{note}\n"


def car(results: dict[str, Any]) -> str:
    """Lengths of Reeds and Shepp's paths in C, beside a table."""
    table = [["Reeds-Shepp in C", "file", "program", "mean error", "largest", "ns a query", "s to build"]]
    for row in results["car"]["rows"]:
        cells = [f"{row['file']:,}", f"{row['bytes']:,}", f"{row['mean']:.2g}", f"{row['largest']:.2g}"]
        table.append([row["what"], *cells, f"{row['nanoseconds']:.0f}", f"{row['seconds']:.1f}"])
    return markdown(table, numbers=6)


def edges(results: dict[str, Any]) -> str:
    """Compiled tests of free space beside Shapely, errors far from the origin, and states that BIT* tests."""
    table = [["map", "edges", "MB", "built in s", "ns a point", "by Shapely", "largest error / side"]]
    for row in results["free_space"]["rows"]:
        seconds = [f"{row['seconds_to_build']:.2g}", f"{row['nanoseconds']:.0f}", f"{row['nanoseconds_shapely']:.0f}"]
        size = [f"{row['edges']:,}", f"{row['bytes'] / 1e6:.2f}"]
        table.append([row["map"], *size, *seconds, f"{row['largest_error']:.1e}"])
    search = [["BIT\\* guided by", "states tested", "s", "arrived"]]
    for row in results["ompl"]["rows"]:
        tested, seconds = (_median(trial[what] for trial in row["trials"]) for what in ("tested", "seconds"))
        arrived = f"{sum(trial['arrived'] for trial in row['trials'])} of {len(row['trials'])}"
        search.append([row["heuristic"], f"{tested:,.0f}", f"{seconds:.1f}", arrived])
    ratios = [row["ratio"] for row in results["utm"]["rows"]]
    note = f"Mean errors in UTM coordinates are at most {max(ratios):.4f} times those at the origin, for all leaves."
    return f"{markdown(table, numbers=6)}\n{markdown(search, numbers=3)}\n{note}\n"


def _median(values: Iterable[float]) -> float:
    return float(np.median(list(values)))
