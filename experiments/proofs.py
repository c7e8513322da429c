"""What is proven of PLRs, and whether it holds: cones, planes and continuous leaves beside one another.

Every section is written as soon as it is measured; ``--only SECTION`` measures sections again and keeps the others as
they are. What a section does is told in its file in ``experiments/proving/``.
"""

from experiments._runner import Section, run
from experiments.proving import _astar, _bounds, _leaves, _sizes

SECTIONS = {
    "sizes": Section(_sizes.sizes),
    "speed": Section(_sizes.speed),
    "astar": Section(_astar.measure),
    "leaves": Section(_leaves.measure, _leaves.draw),
    "bounds": Section(_bounds.bounds),
    "slivers": Section(_bounds.slivers),
}

if __name__ == "__main__":
    run("proofs", __doc__, SECTIONS)
