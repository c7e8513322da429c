"""The table of the experiment `scale`."""

from typing import Any

from experiments._tables import markdown


def table(results: dict[str, Any]) -> str:
    """Both tables of the README, in Markdown."""
    cells = [["workers", "files", "the same", "number", "s"]]
    for row in results["workers"]:
        same = "yes" if row["same"] else "no"
        cells.append([row["kind"], row["digest"][:8], same, f"{row['workers']}", f"{row['seconds']:.1f}"])
    kills, killed = results["kills"], [row for row in results["kills"] if row["killed"]]
    done = ", ".join(f"{row['share']:.0%}" for row in sorted(killed, key=lambda row: row["share"]))
    return markdown(cells, numbers=2) + (
        f"\n{_work_in_words(results['cones'])} of cones. Then {_work_in_words(results['planes'])} of planes, by "
        f"processes that are killed at random moments, {len(killed)} of {len(kills)} before their end, with {done} "
        f"of the checkpoint written: {sum(row['same'] for row in kills)} were resumed to the same file.\n"
    )


def _work_in_words(work: list[int]) -> str:
    return f"{work[0]:,} goals, files of {work[1]:,} bytes"
