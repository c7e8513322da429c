"""Teams large and small, planned by ``bl_plan``, mostly without a heuristic: how soon, how well, within what limits.

Costs are over the sum of what each robot's shortest path costs if it is alone, as exact oracles say. Before a team is
timed, another one is planned in the same workspace, so that nothing is imported or compiled on the way, and the map
is known, but no starts and goals; a section that does otherwise says so. Every section is written as soon as it is
measured; ``--only SECTION`` measures sections again and keeps the others as they are. What a section does is told in
its file in ``experiments/team_sections/``.
"""

from experiments._sections import Section, run_sections
from experiments.team_sections import (
    _cold_start,
    _dbcbs_16,
    _den520d,
    _first,
    _half_a_minute,
    _memory_limits,
    _pair_tests,
    _random,
    _scoring_rate,
    _time_limits,
    _unseen,
)

SECTIONS: dict[str, Section] = {
    "first": _first,
    "half_a_minute": _half_a_minute,
    "den520d": _den520d,
    "dbcbs_16": _dbcbs_16,
    "unseen": _unseen,
    "cold_start": _cold_start,
    "scoring_rate": _scoring_rate,
    "pair_tests": _pair_tests,
    "time_limits": _time_limits,
    "memory_limits": _memory_limits,
    "random": _random,
}

if __name__ == "__main__":
    run_sections("teams", __doc__, SECTIONS)
