"""How large the house is: ``python tests/house.py`` prints files and lines of code, and what a first call runs.

A line of code is one that holds more than a comment or a docstring. What a call runs is counted in a process of its
own: files of the package with a function that ran, and such functions, imports left out.
"""

import ast
import io
import subprocess
import sys
import tokenize
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
    """Lines that hold more than a comment or a docstring."""
    documented = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            documented.update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    code = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in THIN:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - documented)


def main() -> None:
    """Print all of it."""
    for room in ("plr_jax", "tests", "experiments"):
        sources = [path.read_text() for path in sorted((ROOT / room).rglob("*.py"))]
        total = sum(source.count("\n") for source in sources)
        print(f"{room}: {len(sources)} files, {total:,} lines, {sum(map(lines_of_code, sources)):,} of code")
    for name, (before, call) in CALLS.items():
        program = before + COUNT.format(call=call)
        run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
        files, functions = run.stdout.split()
        print(f"{name}: {files} files, {functions} functions")


if __name__ == "__main__":
    main()
