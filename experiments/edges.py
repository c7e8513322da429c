"""What happens at the edges of what PLRs are made for; a section a file in ``edge_sections/``."""

from experiments._sections import Section, run_sections
from experiments.edge_sections import _free_space, _ompl, _utm

SECTIONS: dict[str, Section] = {"utm": _utm, "free_space": _free_space, "ompl": _ompl}

if __name__ == "__main__":
    run_sections("edges", __doc__, SECTIONS)
