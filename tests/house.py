"""Measure the size of the code base.

``python tests/house.py`` prints lines of code, small functions, circles of imports, and what a first call runs.
``python tests/house.py FOLDER ...`` prints only lines and functions of these folders, within a second.
``python tests/house.py --tests [ARGUMENT ...]`` runs pytest with these arguments, without compiled functions of an
earlier run, and prints the CPU seconds (user and system, all processes) and the wall time.

A line of code holds more than a comment or a docstring. A private function counts as used once if its name is read
once in the whole package. What a call runs is counted in a fresh process: files and functions of the package, without
imports.
"""

import ast
import io
import os
import subprocess
import sys
import tempfile
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parent.parent
MAZE = "import plr_jax\nproblem = plr_jax.scenes.maze()\nw, goal = problem.workspace, problem.goals[0]\n"
ORACLE = MAZE + "oracle = plr_jax.VisibilityGraph(w, goal)\noracle(w.sample_free(9, seed=0))\n"
CALLS = {
    "first plr(x)": (
        ORACLE + "plr = plr_jax.from_bytes(plr_jax.construct(oracle, w.bounds, max_leaves=64).to_bytes())",
        "plr([[0.5, 0.5]])",
    ),
    "construct of planes": (ORACLE, "plr_jax.construct(oracle, w.bounds, max_leaves=64)"),
    "VisibilityGraph": (MAZE, "plr_jax.VisibilityGraph(w, goal)"),
    "bl_plan": ("import plr_jax\nproblem = plr_jax.scenes.four_rooms(2)", "plr_jax.bl_plan(problem)"),
    "solve_eikonal": (
        MAZE + "space = plr_jax.PlaneSpace(w, plr_jax.PointRobot())",
        "plr_jax.solve_eikonal(space, goal, max_leaves=500)",
    ),
}
THIN = {getattr(tokenize, kind) for kind in ("COMMENT", "NL", "NEWLINE", "INDENT", "DEDENT", "ENCODING", "ENDMARKER")}
COUNT = """
import inspect, sys
ran = set()
def note(frame, event, _):
    code = frame.f_code
    is_function = code.co_flags & inspect.CO_OPTIMIZED and not code.co_name.startswith("<")  # no body of a class
    if event == "call" and is_function and "/plr_jax/" in code.co_filename:
        ran.add((code.co_filename, code.co_qualname))
sys.setprofile(note)
{call}
sys.setprofile(None)
print(len({{file for file, _ in ran}}), len(ran))
"""


def lines_of_code(source: str) -> int:
    """Count lines that hold more than a comment or a docstring."""
    documented = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            documented.update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    code = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in THIN:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - documented)


def functions_of(tree: ast.AST) -> list[ast.FunctionDef]:
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def body_lines(function: ast.FunctionDef) -> int:
    """Count the lines of a body without its docstring."""
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    return (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


def reads_of(trees: list[ast.Module]) -> Counter[str]:
    """Count how often each name is read, as a variable or as an attribute."""
    nodes = [node for tree in trees for node in ast.walk(tree)]
    names = Counter(node.id for node in nodes if isinstance(node, ast.Name))
    return names + Counter(node.attr for node in nodes if isinstance(node, ast.Attribute))


def import_circles() -> list[list[str]]:
    """Return the groups of files that import one another in a circle, also by imports inside functions."""
    import networkx as nx

    graph = nx.DiGraph()
    for path in sorted((ROOT / "plr_jax").rglob("*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("plr_jax"):
                for module in (node.module, *(f"{node.module}.{alias.name}" for alias in node.names)):
                    file = ROOT / module.replace(".", "/")
                    if file.with_suffix(".py").exists():
                        graph.add_edge(name, module)
    return [sorted(group) for group in nx.strongly_connected_components(graph) if len(group) > 1]


def print_size(folder: Path, reads: Counter[str]) -> None:
    """Print files, lines and functions of one folder."""
    sources = [path.read_text() for path in sorted(folder.rglob("*.py"))] if folder.is_dir() else [folder.read_text()]
    total = sum(source.count("\n") for source in sources)
    functions = [function for source in sources for function in functions_of(ast.parse(source))]
    short = sum(body_lines(function) <= 2 for function in functions)
    once = sum(f.name.startswith("_") and not f.name.startswith("__") and reads[f.name] == 1 for f in functions)
    name = folder.relative_to(ROOT)
    print(f"{name}: {len(sources)} files, {total:,} lines, {sum(map(lines_of_code, sources)):,} of code; ", end="")
    print(f"{len(functions):,} functions, {short} with at most 2 lines, {once} private and used once")


def print_cost_of_tests(arguments: list[str]) -> int:
    """Run pytest, print what it takes, and return its exit status."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": folder}
        begin = os.times()
        status = subprocess.call([sys.executable, "-m", "pytest", *arguments], cwd=ROOT, env=environment)
        end = os.times()
    cpu = end.children_user + end.children_system - begin.children_user - begin.children_system
    print(f"tests: {cpu:.0f} CPU s, {end.elapsed - begin.elapsed:.0f} s wall on {os.cpu_count()} cores")
    return status


def main() -> None:
    """Print all measurements, or only those of the folders that are named."""
    if sys.argv[1:2] == ["--tests"]:
        sys.exit(print_cost_of_tests(sys.argv[2:]))
    trees = [ast.parse(path.read_text()) for path in (ROOT / "plr_jax").rglob("*.py")]
    reads = reads_of(trees)
    for folder in sys.argv[1:] or ("plr_jax", "tests", "experiments"):
        print_size((ROOT / folder).resolve(), reads)
    if sys.argv[1:]:
        return
    print("circles of imports:", import_circles())
    for name, (before, call) in CALLS.items():
        program = before + COUNT.format(call=call)
        run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
        files, ran = run.stdout.split()
        print(f"{name}: {files} files, {ran} functions")


if __name__ == "__main__":
    main()
