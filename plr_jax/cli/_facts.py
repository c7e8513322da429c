"""What ``plr-jax info`` tells of a file."""

from collections.abc import Iterator
from typing import Any


def facts_of(held: Any) -> dict[str, Any]:
    """What JSON can hold of a PLR or of pairs."""
    from plr_jax._arrays import told
    from plr_jax.plr import PLR

    is_plr, domain = isinstance(held, PLR), held.domain
    facts = {
        "holds": type(held).__name__,
        "lo": told(domain.lo),
        "hi": told(domain.hi),
        "periodic_axes": [axis for axis, is_periodic in enumerate(domain.periodic) if is_periodic],
        "num_bytes": held.num_bytes,
    }
    names = ["label", "num_leaves", "num_unreachable", "num_corners", "num_landmarks", "depth", "max_error"]
    facts |= {name: getattr(held, name) for name in names if hasattr(held, name)}
    if not is_plr:  # whose tables may take long to make
        return facts
    return facts | {"leaf": held.leaf.name, "resident_bytes": held.resident_bytes}


def lines_of(facts: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """The same for people: names, and what is said of them."""
    is_plr = facts["holds"] == "PLR"
    yield "file", facts["file"]
    yield "label", facts.get("label") or "none"
    yield "leaf" if is_plr else "holds", facts.get("leaf", facts["holds"])
    periodic = f", periodic along axes {facts['periodic_axes']}" if facts["periodic_axes"] else ""
    yield "domain", f"{facts['lo']} to {facts['hi']} ({len(facts['lo'])}-D{periodic})"
    if is_plr:
        yield "leaves", f"{facts['num_leaves']:,}, of which {facts['num_unreachable']:,} unreachable"
        yield "depth", f"{facts['depth']}"
        yield "proof", _proof_of(facts)
        yield "bytes", f"{facts['num_bytes']:,} in the file, {facts['resident_bytes']:,} in memory"
    else:
        yield "corners", f"{facts['num_corners']:,}"
        if facts.get("num_landmarks"):
            yield "landmarks", f"{facts['num_landmarks']:,}, by which distances are bounds"
        yield "bytes", f"{facts['num_bytes']:,} in the file"


def _proof_of(facts: dict[str, Any]) -> str:
    return "none" if facts["max_error"] is None else f"largest error {facts['max_error']:.3g}"
