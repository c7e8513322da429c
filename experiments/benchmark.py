"""The benchmark: every cost of the library beside that of its rivals, section by section.

Every section is written as soon as it is measured, so an interrupted run keeps what it has; ``--only SECTION``
measures sections again and keeps the others as they are. What a section compares, and how, is told in its file in
``experiments/benchmarks/``.
"""

from experiments._sections import Section, run_sections
from experiments.benchmarks import (
    _accuracy,
    _cold_start,
    _construct,
    _gradient,
    _growth,
    _heuristic,
    _oracle,
    _query,
)

SECTIONS: dict[str, Section] = {
    "query": _query,
    "gradient": _gradient,
    "accuracy": _accuracy,
    "construct": _construct,
    "oracle": _oracle,
    "heuristic": _heuristic,
    "cold_start": _cold_start,
    "growth": _growth,
}

if __name__ == "__main__":
    run_sections("benchmark", __doc__, SECTIONS)
