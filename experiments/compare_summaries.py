"""Files that hold all distances of a map, at equal bytes: ours, and whatever else tells the distance of two points.

Every section is a rival on a map, written as soon as it is measured; ``--only arena_network`` measures it again and
keeps the others as they are. What a rival does is told in its file in ``experiments/summaries/``. All are given exact
distances as often as they ask, and as many settings as their file says, of which the best is chosen on pairs that are
neither those of training nor those of the test. The test pairs are the same for all
(``experiments/summaries/_truth.py``).
"""

from experiments._sections import Section, run_sections
from experiments.summaries import (
    _embedding,
    _fastmap,
    _full_table,
    _landmarks,
    _network,
    _ours,
    _polygons,
    _product,
    _straight_line,
)
from experiments.summaries._rows import MAX_BYTES, OnMap

COMPILED = {
    "ours": _ours.candidates,
    "product_plr": _product.candidates,
    "straight_line": _straight_line.candidates,
    "full_table": _full_table.candidates,
    "landmark_tables": _landmarks.tables,
    "landmark_plrs": _landmarks.plrs,
    "fastmap": _fastmap.candidates,
    "embedding": _embedding.candidates,
    "network": _network.candidates,
}
BY_POLYGON = {"spanner": _polygons.spanners, "polygon": _polygons.exact}

SECTIONS: dict[str, Section] = {
    f"{name}_{rival.name}": rival
    for name in MAX_BYTES
    for rival in (
        *(OnMap(name, rival, candidates) for rival, candidates in COMPILED.items()),
        *(OnMap(name, rival, candidates, compiled=False, every=True) for rival, candidates in BY_POLYGON.items()),
    )
}

if __name__ == "__main__":
    run_sections("compare_summaries", __doc__, SECTIONS)
