"""PLRs straight from configuration spaces and closed forms, without a roadmap: beside roadmaps, grids and tables.

Every section is written as soon as it is measured; ``--only SECTION`` measures sections again and keeps the others as
they are. What a section does is told in its file in ``experiments/solving/``.
"""

from experiments._runner import Section, run
from experiments.solving import _bodies, _cars, _nodes, _plane, _speed_map

SECTIONS = {
    "plane": Section(_plane.measure),
    "speed_map": Section(_speed_map.measure),
    "bodies": Section(_bodies.measure),
    "cars": Section(_cars.measure),
    "nodes": Section(_nodes.measure),
}

if __name__ == "__main__":
    run("solve", __doc__, SECTIONS)
