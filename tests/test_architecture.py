"""The layering of the package, enforced by reading its imports."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "plr_jax"
# From the bottom up; a part imports itself and what stands before it. Parts of one row never import one another.
LAYERS = [
    ["_types"],
    ["_arrays"],
    ["_compiled", "_files"],
    ["geometry"],
    ["robots"],
    ["collision"],
    ["_problem"],
    ["_validate"],
    ["oracles", "plr", "planners", "spaces", "traced"],
    ["pairs"],
    ["_io"],
    ["_lookahead"],
    ["_descend", "metrics", "plot", "scenes", "eikonal", "ompl"],
    ["cli", "guides"],
    ["__main__"],
]
# Inside the room that stores, likewise; what stands in its folders before the leaves knows no leaf model.
PLR_LAYERS = [
    ["tree", "folding"],
    ["faces", "cell_memory"],
    ["finite_elements", "frame", "coding", "sampling"],
    ["container", "parallel_builds"],
    ["certificate"],
    ["growth"],
    ["best_partition"],
    ["leaves"],
    ["_file"],
    ["_proof"],
    ["tables"],
    ["query", "small_batches"],
    ["team"],
    ["portable"],
    ["_plr"],
    ["_stack"],
    ["source_sight"],
    ["_trace"],
    ["_construct"],
    ["_construct_many"],
]
# And inside that of the planners.
PLANNER_LAYERS = [
    ["_heuristics", "_solution"],
    ["lattice"],
    ["best_first", "lacam", "reservations", "sequential", "shorten", "through_time"],
    ["driver"],
    ["under_way"],
]
# What each may import, where that is less than all before it.
PLR_IMPORTS = {
    "growth": {"tree", "sampling", "coding", "certificate"},
}
ROOMS = {"": LAYERS, "plr": PLR_LAYERS, "planners": PLANNER_LAYERS}
TREES = {path.relative_to(PACKAGE): ast.parse(path.read_text()) for path in sorted(PACKAGE.rglob("*.py"))}
LEAF_MODELS = tuple(f"plr_jax.plr.leaves.{name}" for name in ("plane", "continuous", "cone"))


def imported_modules(tree: ast.AST) -> set[str]:
    """Dotted names of all modules that a file imports, anywhere in it."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"from {'.' * node.level}{node.module or ''}: relative import; write it absolute"
            # `from plr_jax import metrics` may import a module as well as a name.
            names.add(node.module)
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return names


IMPORTS = {path: imported_modules(tree) for path, tree in TREES.items()}


def parts_of(path: Path, room: str) -> set[str]:
    """Parts of a room that a file imports: of the whole `_types`, `oracles`, ..."""
    prefix = f"plr_jax.{room}." if room else "plr_jax."
    ours = {name.removeprefix(prefix).split(".")[0] for name in IMPORTS[path] if name.startswith(prefix)}
    return {part for part in ours if (PACKAGE / room / part).is_dir() or (PACKAGE / room / f"{part}.py").exists()}


def test_every_part_of_a_room_has_a_layer_and_imports_what_is_below():
    for room, layers in ROOMS.items():
        part_of = {
            path: path.relative_to(room).parts[0].removesuffix(".py") for path in TREES if path.is_relative_to(room)
        }
        assert set(part_of.values()) - {"__init__"} == {part for layer in layers for part in layer}
        below: dict[str, set[str]] = {"__init__": set().union(*layers)}
        for row, layer in enumerate(layers):
            below |= dict.fromkeys(layer, set().union(*layers[:row]))
        below |= PLR_IMPORTS if room == "plr" else {}
        above = {str(path): parts_of(path, room) - {part} - below[part] for path, part in part_of.items()}
        assert not {path: parts for path, parts in above.items() if parts}


def test_only_leaves_know_the_leaf_models():
    """Others import what `plr/leaves/__init__.py` offers, no file of a leaf model."""
    others = [path for path in TREES if not path.is_relative_to("plr/leaves") and path != Path("plr/__init__.py")]
    assert not [path for path in others if any(name.startswith(LEAF_MODELS) for name in IMPORTS[path])]


def test_only_plot_imports_matplotlib():
    drawing = {
        path for path in TREES if {"matplotlib", "mpl_toolkits"} & {name.split(".")[0] for name in IMPORTS[path]}
    }
    assert drawing and all(path.is_relative_to("plot") for path in drawing)


def test_the_parser_sees_imports_inside_functions():
    tree = ast.parse("def f():\n    from plr_jax import plot\n    import matplotlib.figure\n")
    assert {"plr_jax.plot", "matplotlib.figure"} <= imported_modules(tree)
