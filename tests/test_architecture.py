"""Rules of the source: the layering of imports, and first sentences of docstrings that are plain.

A first sentence says what the thing is or does, in at most 25 words. It may not start with a pronoun or with "What",
"Of" or "Where", and it ends with a period.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "plr_jax"
# Parts of the package and of some of its rooms, from the bottom up, with a slash between layers. A part imports
# itself and parts of lower layers; parts of one layer never import one another.
LAYERS = """_types _progress / _arrays / _compiled _files / geometry / robots / collision / _problem / _validate /
    oracles plr planners spaces traced / buildings / pairs / _io / _lookahead /
    _descend metrics plot scenes eikonal ompl / rasters / cli guides / __main__"""
PLR_LAYERS = """tree folding / leaf_faces source_cache / finite_elements frame sizes coding sampling /
    bound_classes container / certificate / growth / best_partition / leaves / _file /
    tables / query / team / portable / _tunable / _plr / _stack / _trace / _construct / _construct_many"""
PLANNER_LAYERS = """_heuristics _solution / lattice /
    best_first lacam reservations sequential shorten through_time / searches / driver / replanning"""
PLR_IMPORTS = {"growth": {"tree", "sampling", "coding", "certificate"}}  # parts that may import less
ROOMS = {"": LAYERS, "plr": PLR_LAYERS, "planners": PLANNER_LAYERS}
LEAVES = (Path(__file__).parents[1] / "plr_jax" / "plr" / "leaves").iterdir()
LEAF_MODELS = tuple(f"plr_jax.plr.leaves.{path.stem}" for path in LEAVES if not path.stem.startswith(("__", "base")))
OPENERS = re.compile(
    r"(what|of|where|who(m|se)?|which|th(e|o)se|th(at|is)|such|its?|they|them|their|s?he|we|our|your?|ones?|another|each|both"
    r"|some\w*|all|any(one|thing)?|none|nothing|every\w*|the (same|others?))\b(?!-)",
    re.IGNORECASE,
)
MAX_WORDS = 25


def statements_of(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield a file and all its statements, without expressions, which are the most nodes."""
    nodes = [tree]
    while nodes:
        yield (node := nodes.pop())
        kinds = ast.stmt | ast.excepthandler | ast.match_case
        nodes += [child for child in ast.iter_child_nodes(node) if isinstance(child, kinds)]


@pytest.fixture(scope="module")
def files() -> dict[Path, list[ast.AST]]:
    """Return the statements of each file of the package."""
    paths = sorted(PACKAGE.rglob("*.py"))
    return {path.relative_to(PACKAGE): list(statements_of(ast.parse(path.read_text()))) for path in paths}


@pytest.fixture(scope="module")
def imports(files) -> dict[Path, set[str]]:
    return {path: imported_modules(statements) for path, statements in files.items()}


def imported_modules(statements: list[ast.AST]) -> set[str]:
    """Return the dotted names of all modules that statements import."""
    names = set()
    for node in statements:
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"from {'.' * node.level}{node.module or ''}: relative import; write it absolute"
            # `from plr_jax import metrics` may import a module as well as a name.
            names.add(node.module)
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return names


def parts_of(names: set[str], room: str) -> set[str]:
    """Return the parts of a room that are imported: of the whole package `_types`, `oracles`, ..."""
    prefix = f"plr_jax.{room}." if room else "plr_jax."
    ours = {name.removeprefix(prefix).split(".")[0] for name in names if name.startswith(prefix)}
    return {part for part in ours if (PACKAGE / room / part).is_dir() or (PACKAGE / room / f"{part}.py").exists()}


def test_parts_import_only_layers_below(imports):
    for room, layers_of_room in ROOMS.items():
        layers = [layer.split() for layer in layers_of_room.split("/")]
        part_of = {p: p.relative_to(room).parts[0].removesuffix(".py") for p in imports if p.is_relative_to(room)}
        assert set(part_of.values()) - {"__init__"} == {part for layer in layers for part in layer}
        below: dict[str, set[str]] = {"__init__": set().union(*layers)}
        for row, layer in enumerate(layers):
            below |= dict.fromkeys(layer, set().union(*layers[:row]))
        below |= PLR_IMPORTS if room == "plr" else {}
        above = {str(path): parts_of(imports[path], room) - {part} - below[part] for path, part in part_of.items()}
        assert not {path: parts for path, parts in above.items() if parts}


def test_only_leaves_import_leaf_models(imports):
    """Other rooms import what `plr/leaves/__init__.py` offers."""
    others = [path for path in imports if not path.is_relative_to("plr/leaves") and path != Path("plr/__init__.py")]
    assert not [path for path in others if any(name.startswith(LEAF_MODELS) for name in imports[path])]


def test_only_plot_imports_matplotlib(imports):
    libraries = {path: {name.split(".")[0] for name in names} for path, names in imports.items()}
    drawing = {path for path, names in libraries.items() if {"matplotlib", "mpl_toolkits"} & names}
    assert drawing and all(path.is_relative_to("plot") for path in drawing)


def test_imports_inside_functions_are_found():
    tree = ast.parse("def f():\n    from plr_jax import plot\n    import matplotlib.figure\n")
    assert {"plr_jax.plot", "matplotlib.figure"} <= imported_modules(list(statements_of(tree)))


def complaints(statements: list[ast.AST]) -> Iterator[str]:
    """Yield the name and the fault of each docstring that breaks a rule."""
    for node in statements:
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        text = ast.get_docstring(node)
        if text is None:
            continue
        name = getattr(node, "name", "module")
        paragraph = " ".join(text.split("\n\n")[0].split())
        sentence = re.split(r"(?<=[.!?])\s+(?=[A-Z`])", re.sub(r"\b(e\.g|i\.e|cf|vs)\.", r"\1", paragraph))[0]
        words = sentence.split()
        if OPENERS.match(sentence):
            yield f'{name} starts with "{words[0]}": {sentence}'
        if len(words) > MAX_WORDS:
            yield f"{name} has {len(words)} words, at most {MAX_WORDS} are allowed: {sentence}"
        if not sentence.endswith("."):
            yield f"{name} does not end with a period: {sentence}"


def test_docstrings_start_with_plain_sentences(files):
    faults = [f"{path}:{fault}" for path, statements in files.items() for fault in complaints(statements)]
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize("docstring", ["What is near.", "A box", "A " + "very " * 24 + "long sentence."])
def test_bad_first_sentences_are_found(docstring):
    (_,) = complaints(list(statements_of(ast.parse(f'def f():\n    """{docstring}"""'))))
