"""Files that commands are given: PLRs, and pairs, of which some commands take the distance to a goal."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from plr_jax.cli._inputs import parse_goal

if TYPE_CHECKING:
    from plr_jax.pairs import GridPairs, PairPLR


def file_holds_pairs(file: Path) -> bool:
    """Whether a file is of pairs."""
    from plr_jax.plr.file.container import holds_pairs, read_bytes

    try:
        return holds_pairs(read_bytes(file))
    except ValueError:  # which whoever reads it tells better
        return False


def loaded(file: Path) -> Any:
    """What a file holds."""
    from plr_jax._io import load  # and with it JAX, which PLRs are answered without

    return load(file)


def goal_of_pairs(pairs: "PairPLR | GridPairs", file: Path, goal: str | None) -> Any:
    """The distance to the goal by the pairs in a file."""
    if goal is None:
        raise ValueError(f"{file} holds the distance between any two points: give one with --goal X,Y.")
    return pairs.to(parse_goal(goal))
