"""Experiments of several sections, each in a file of its own, which are measured and kept one by one."""

from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from experiments._results import command_line, environment, output_folder, read, write


class Section(Protocol):
    """What a section's file has."""

    def measure(self, seed: int, smoke: bool, /) -> dict[str, Any]:
        """Results fit for JSON."""
        ...

    def table(self, results: dict[str, Any], /) -> str:
        """The results as text."""
        ...


@runtime_checkable
class DrawnSection(Section, Protocol):
    """What a section's file has that draws figures too."""

    def draw(self, results: dict[str, Any], output: Path, /) -> list[Path]:
        """The files of its figures."""
        ...


def run_sections(name: str, purpose: str | None, sections: dict[str, Section]) -> None:
    """Run an experiment of sections from the command line, all of them or those that ``--only`` names."""
    parser = command_line(name, purpose)
    parser.add_argument("--only", nargs="+", choices=sections, default=list(sections), help="sections to measure")
    arguments = parser.parse_args()
    output = output_folder(arguments)
    if not arguments.draw:
        for section in arguments.only:
            print(f"== {section}", flush=True)
            measured = sections[section].measure(arguments.seed, arguments.smoke)
            old = read(output, name)["results"] if (output / f"{name}.json").exists() else {}
            kept = {each: measured if each == section else old.get(each) for each in sections}
            results = {each: part for each, part in kept.items() if part is not None}
            record = {"experiment": name, "smoke": arguments.smoke, "seed": arguments.seed, **environment()}
            print(f"wrote {write(output, name, {**record, 'results': results})}")
    _draw(output, name, sections)


def _draw(output: Path, name: str, sections: dict[str, Section]) -> None:
    """All tables as one text, and the figures."""
    results = read(output, name)["results"]
    text = "\n".join(f"{section}\n\n{sections[section].table(part)}" for section, part in results.items())
    print(text)
    tables = output / f"{name}.txt"
    tables.write_text(text, encoding="utf-8")
    figures = [figure for each, part in results.items() for figure in figures_of(sections[each], part, output)]
    for path in [tables, *figures]:
        print(f"wrote {path}")


def figures_of(section: Section, results: dict[str, Any], output: Path) -> list[Path]:
    """The files of a section's figures, drawn, where it has any."""
    return section.draw(results, output) if isinstance(section, DrawnSection) else []
