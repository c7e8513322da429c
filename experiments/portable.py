"""What runs at the other end: readers in C and NumPy, tables at the command line, a heuristic of cars.

See ``porting``. A C compiler called ``cc`` and ``size`` are needed.
"""

from experiments._sections import Section, run_sections
from experiments.porting import _car, _query, _readers

SECTIONS: dict[str, Section] = {"readers": _readers, "query": _query, "car": _car}

if __name__ == "__main__":
    run_sections("portable", "Readers in C and NumPy, tables at the command line, a heuristic of cars.", SECTIONS)
