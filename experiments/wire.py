"""Files on their way: prefixes that are PLRs with bounds, what that costs in bytes, and what of a file is fetched.

Every section is written as soon as it is measured; ``--only SECTION`` measures sections again and keeps the others.
What a section does is told in its file in ``experiments/wire_sections/``.
"""

from experiments._sections import Section, run_sections
from experiments.wire_sections import pair_prefixes, prefixes, ranges, sizes

SECTIONS: dict[str, Section] = {
    "prefixes": prefixes,
    "pair_prefixes": pair_prefixes,
    "sizes": sizes,
    "ranges": ranges,
}

if __name__ == "__main__":
    run_sections("wire", __doc__, SECTIONS)
