"""What is proven of PLRs, and whether it holds: cones, planes and continuous leaves beside one another.

Every section is written as soon as it is measured; ``--only SECTION`` measures sections again and keeps the others as
they are. What a section does is told in its file in ``experiments/proving/``.
"""

from experiments._sections import Section, run_sections
from experiments.proving import (
    _astar,
    _bands,
    _bounds,
    _gradient,
    _leaves,
    _notch,
    _plain,
    _sizes,
    _slivers,
    _speed,
    _theorem2,
)

SECTIONS: dict[str, Section] = {
    "sizes": _sizes,
    "plain": _plain,
    "speed": _speed,
    "bands": _bands,
    "gradient": _gradient,
    "notch": _notch,
    "theorem2": _theorem2,
    "astar": _astar,
    "leaves": _leaves,
    "bounds": _bounds,
    "slivers": _slivers,
}

if __name__ == "__main__":
    run_sections("proofs", __doc__, SECTIONS)
