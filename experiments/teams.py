"""Teams large and small, planned by ``bl_plan``, mostly without a heuristic: how soon, how well, within what limits.

Costs are over the sum of what each robot's shortest path costs if it is alone, as exact oracles say. Before a team is
timed, another one of its kind is planned, so that nothing is compiled or imported on the way, and nothing of the team
is known. Every section is written as soon as it is measured; ``--only SECTION`` measures sections again and keeps the
others as they are. What a section does is told in its file in ``experiments/planning/``.
"""

from experiments._sections import Section, run_sections
from experiments.planning import (
    _den520d,
    _first,
    _longer,
    _memory_limits,
    _n16,
    _pair_tests,
    _random,
    _rate,
    _starting,
    _time_limits,
    _unseen,
)

SECTIONS: dict[str, Section] = {
    "first": _first,
    "longer": _longer,
    "den520d": _den520d,
    "n16": _n16,
    "unseen": _unseen,
    "starting": _starting,
    "rate": _rate,
    "pair_tests": _pair_tests,
    "time_limits": _time_limits,
    "memory_limits": _memory_limits,
    "random": _random,
}

if __name__ == "__main__":
    run_sections("teams", __doc__, SECTIONS)
