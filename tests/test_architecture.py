"""The layering of the package, enforced by reading its imports."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "plr_jax"
# From the bottom up; a part imports itself and what stands before it. Parts of one row never import one another.
LAYERS = [
    ["_types"],
    ["_arrays", "_atomic", "_pytree"],
    ["_cores"],
    ["_deadline"],
    ["_documents"],
    ["geometry"],
    ["robots"],
    ["collision"],
    ["_problem"],
    ["_validate"],
    ["oracles", "plr", "planners", "spaces"],
    ["pairs"],
    ["_io"],
    ["optimize", "metrics", "plot", "scenes", "eikonal", "remote", "ompl"],
    ["cli"],
    ["__main__"],
]
# Inside the room that stores, likewise; what stands in its folders before the leaves knows no leaf model.
PLR_LAYERS = [
    ["partition", "folding"],
    ["query", "sampling", "file"],
    ["certificate"],
    ["growth"],
    ["leaves"],
    ["_file"],
    ["portable"],
    ["_plr"],
    ["_assembly", "_location", "_stack"],
    ["_certify"],
    ["_checkpoint", "_trace", "refinement"],
    ["_construct"],
    ["_construct_many", "_coarsen"],
]
# And inside that of the planners.
PLANNER_LAYERS = [
    ["_heuristics", "_solution"],
    ["_budget", "_sba_star"],
    ["lattice"],
    ["bl", "lacam", "replanning", "smoothing"],
    ["searches"],
    ["bl_plan"],
]
# What each may import, where that is less than all before it.
PLR_IMPORTS = {
    "growth": {"partition", "query", "sampling", "file", "certificate"},
}
SOURCES = sorted(PACKAGE.rglob("*.py"))
PLR, PLANNERS = PACKAGE / "plr", PACKAGE / "planners"
PLR_SOURCES, PLANNER_SOURCES = ([path for path in SOURCES if path.is_relative_to(room)] for room in (PLR, PLANNERS))
LEAF_MODELS = tuple(f"plr_jax.plr.leaves.{name}" for name in ("plane", "continuous", "cone"))
LEAF_NAMES = {"plane", "continuous", "smooth", "cone"}


def imported_modules(path: Path) -> set[str]:
    """Dotted names of all modules that a file imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import; write it absolute"
            # `from plr_jax import metrics` may import a module as well as a name.
            names.add(node.module)
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return names


def parts_of(path: Path, package: Path = PACKAGE) -> set[str]:
    """Parts of a package that a file imports: of the whole `_types`, `oracles`, ..."""
    prefix = ".".join(package.relative_to(PACKAGE.parent).parts) + "."
    ours = {name.removeprefix(prefix).split(".")[0] for name in imported_modules(path) if name.startswith(prefix)}
    return {part for part in ours if (package / part).is_dir() or (package / f"{part}.py").exists()}


def part_of(path: Path, package: Path = PACKAGE) -> str:
    """The part of a package that a file belongs to."""
    return path.relative_to(package).parts[0].removesuffix(".py")


def below(part: str, layers: list[list[str]]) -> set[str]:
    """The parts that a part may import."""
    row = next(row for row, parts in enumerate(layers) if part in parts)
    return {other for parts in layers[:row] for other in parts}


def test_every_part_has_a_layer():
    found = {part_of(path) for path in SOURCES} - {"__init__"}
    assert found == {part for layer in LAYERS for part in layer}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_downward(path):
    part = part_of(path)
    if part != "__init__":
        assert parts_of(path) - {part} <= below(part, LAYERS)


def test_every_part_of_the_room_that_stores_has_a_layer():
    found = {part_of(path, PLR) for path in PLR_SOURCES} - {"__init__"}
    assert found == {part for layer in PLR_LAYERS for part in layer}


@pytest.mark.parametrize("path", PLR_SOURCES, ids=lambda path: str(path.relative_to(PLR)))
def test_imports_inside_the_room_that_stores_point_downward(path):
    part = part_of(path, PLR)
    if part != "__init__":
        assert parts_of(path, PLR) - {part} <= PLR_IMPORTS.get(part, below(part, PLR_LAYERS))


def test_every_part_of_the_planners_has_a_layer():
    found = {part_of(path, PLANNERS) for path in PLANNER_SOURCES} - {"__init__"}
    assert found == {part for layer in PLANNER_LAYERS for part in layer}


@pytest.mark.parametrize("path", PLANNER_SOURCES, ids=lambda path: str(path.relative_to(PLANNERS)))
def test_imports_inside_the_planners_point_downward(path):
    part = part_of(path, PLANNERS)
    if part != "__init__":
        assert parts_of(path, PLANNERS) - {part} <= below(part, PLANNER_LAYERS)


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_only_leaves_know_the_leaf_models(path):
    """Outside of their folder, which lists them, and of the public list nothing imports one or asks which it is."""
    if (path.parent == PLR and path.name == "__init__.py") or path.is_relative_to(PLR / "leaves"):
        return
    assert not [name for name in imported_modules(path) if name.startswith(LEAF_MODELS)]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Compare | ast.MatchValue):
            assert not {part.value for part in ast.walk(node) if isinstance(part, ast.Constant)} & LEAF_NAMES


def test_no_two_classes_or_public_functions_share_a_name():
    homes: dict[str, list[str]] = {}
    for path in SOURCES:
        for node in ast.parse(path.read_text()).body:
            is_class = isinstance(node, ast.ClassDef)
            if is_class or (isinstance(node, ast.FunctionDef) and not node.name.startswith("_")):
                homes.setdefault(node.name, []).append(str(path.relative_to(PACKAGE)))
    shared = {name: places for name, places in homes.items() if len(places) > 1}
    assert shared.keys() <= {"save", "load"}  # of a PLR, and with their room before them of a scene or a picture


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_only_plot_imports_matplotlib(path):
    if {"matplotlib", "mpl_toolkits"} & {name.split(".")[0] for name in imported_modules(path)}:
        assert part_of(path) == "plot"


def test_the_parser_sees_imports_inside_functions(tmp_path):
    source = tmp_path / "x.py"
    source.write_text("def f():\n    from plr_jax import plot\n    import matplotlib.figure\n")
    assert {"plr_jax.plot", "matplotlib.figure"} <= imported_modules(source)
