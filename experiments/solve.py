"""PLRs straight from configuration spaces and closed forms, without a roadmap: beside roadmaps, grids and tables.

Every section is written as soon as it is measured; ``--only SECTION`` measures sections again and keeps the others as
they are. What a section does is told in its file in ``experiments/solving/``.
"""

from experiments._sections import Section, run_sections
from experiments.solving import _bodies, _cars, _nodes, _plane, _speed_map

SECTIONS: dict[str, Section] = {
    "plane": _plane,
    "speed_map": _speed_map,
    "bodies": _bodies,
    "cars": _cars,
    "nodes": _nodes,
}

if __name__ == "__main__":
    run_sections("solve", __doc__, SECTIONS)
