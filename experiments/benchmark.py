"""The benchmark: every cost of the library beside that of its rivals, section by section.

Every section is written as soon as it is measured, so an interrupted run keeps what it has; ``--only SECTION``
measures sections again and keeps the others as they are. What a section compares, and how, is told in its file in
``experiments/benchmarks/``.
"""

from pathlib import Path

from experiments._results import command_line, environment, output_folder, read, write
from experiments.benchmarks import (
    _accuracy,
    _cold_start,
    _construct,
    _gradient,
    _growth,
    _heuristic,
    _oracle,
    _planner,
    _query,
)

NAME = "benchmark"
SECTIONS = {
    "query": _query,
    "gradient": _gradient,
    "accuracy": _accuracy,
    "construct": _construct,
    "oracle": _oracle,
    "heuristic": _heuristic,
    "planner": _planner,
    "cold_start": _cold_start,
    "growth": _growth,
}


def main() -> None:
    parser = command_line(NAME, __doc__)
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=list(SECTIONS), help="sections to measure")
    arguments = parser.parse_args()
    output = output_folder(arguments)
    if not arguments.draw:
        for section in arguments.only:
            print(f"== {section}", flush=True)
            _keep(output, section, arguments.seed, arguments.smoke)
    _draw(output)


def _keep(output: Path, section: str, seed: int, smoke: bool) -> None:
    """Measure a section and write it beside those that are in the file already."""
    measured = SECTIONS[section].measure(seed, smoke)
    old = read(output, NAME)["results"] if (output / f"{NAME}.json").exists() else {}
    results = {
        name: measured if name == section else old[name] for name in SECTIONS if name == section or name in old
    }
    record = {"experiment": NAME, "smoke": smoke, "seed": seed, **environment(), "results": results}
    print(f"wrote {write(output, NAME, record)}")


def _draw(output: Path) -> None:
    """All tables as one text, and the figures."""
    results = read(output, NAME)["results"]
    text = "\n".join(f"{name}\n\n{SECTIONS[name].table(part)}" for name, part in results.items())
    print(text)
    tables = output / f"{NAME}.txt"
    tables.write_text(text, encoding="utf-8")
    for path in [tables, *(figure for name, part in results.items() for figure in SECTIONS[name].draw(part, output))]:
        print(f"wrote {path}")


if __name__ == "__main__":
    main()
