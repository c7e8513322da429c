"""The benchmark: every cost of the library beside that of its rivals, section by section.

Every section is written as soon as it is measured, so an interrupted run keeps what it has; ``--only SECTION``
measures sections again and keeps the others as they are. What a section compares, and how, is told in its file in
``experiments/benchmarks/``.
"""

from experiments._runner import Section, run
from experiments.benchmarks import _accuracy, _oracle, _query

SECTIONS = {
    "query": Section(_query.measure, _query.draw),
    "accuracy": Section(_accuracy.measure, _accuracy.draw),
    "oracle": Section(_oracle.measure),
}

if __name__ == "__main__":
    run("benchmark", __doc__, SECTIONS)
