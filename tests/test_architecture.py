"""The layering of the package, enforced by reading its imports."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "plr_jax"
LAYER_0 = [
    "_types",
    "_arrays",
    "_atomic",
    "_box",
    "_partition",
    "_geometry",
    "_polygons",
    "_workspace",
    "_robot",
    "_collision",
    "_obstacles",
    "_problem",
    "_validate",
    "_graph",
]
SOURCES = sorted(PACKAGE.rglob("*.py"))


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


def parts_of(path: Path) -> set[str]:
    """Top-level parts of the package that a file imports: `_box`, `oracles`, ..."""
    ours = {name.split(".")[1] for name in imported_modules(path) if name.startswith("plr_jax.")}
    return {part for part in ours if (PACKAGE / part).is_dir() or (PACKAGE / f"{part}.py").exists()}


def part_of(path: Path) -> str:
    """The top-level part that a file belongs to."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def test_every_private_top_level_file_has_a_place_in_layer_0():
    found = {path.stem for path in PACKAGE.glob("_*.py")} - {"__init__"}
    assert found <= set(LAYER_0)


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_downward(path):
    part, imports = part_of(path), parts_of(path) - {part_of(path)}
    if part in LAYER_0:
        assert imports <= set(LAYER_0[: LAYER_0.index(part)])
    elif part not in ("cli", "__init__"):  # rooms and leaves, which never import one another
        assert imports <= set(LAYER_0)


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_only_plot_imports_matplotlib(path):
    if {"matplotlib", "mpl_toolkits"} & {name.split(".")[0] for name in imported_modules(path)}:
        assert part_of(path) == "plot"


def test_the_parser_sees_imports_inside_functions(tmp_path):
    source = tmp_path / "x.py"
    source.write_text("def f():\n    from plr_jax import plot\n    import matplotlib.figure\n")
    assert {"plr_jax.plot", "matplotlib.figure"} <= imported_modules(source)
