"""How much the suite notices: random single changes of the package, and the share of them that tests fail on.

``python tests/mutations.py --number 200 --seed 0`` draws places of operators, comparisons and constants in
``plr_jax``, changes one at a time in a copy, and runs the tests of its room there, then, if these pass and with
``--whole``, all tests. A change that is not noticed is printed: it is equivalent to the original, or asks for a test.
"""

import argparse
import ast
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
OPERATORS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "*", ast.Pow: "*"}
COMPARISONS = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="}
SECONDS = 900  # a change after which tests never end is noticed


class Mutation(NamedTuple):
    """Source text from ``begin`` to ``end``, which are byte offsets in a file, and what to write in its place."""

    path: Path
    begin: int
    end: int
    text: str


def mutations_of(path: Path) -> Iterator[Mutation]:
    """All single changes of a file, but for annotations, messages of errors, and texts."""
    source = path.read_bytes()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def between(left: ast.expr, right: ast.expr, text: str) -> Iterator[Mutation]:
        begin = starts[left.end_lineno - 1] + left.end_col_offset
        end = starts[right.lineno - 1] + right.col_offset
        if source[begin:end].strip() and not set(source[begin:end]) & set(b"()#\n"):
            yield Mutation(path, begin, end, f" {text} ")

    def visit(node: ast.AST) -> Iterator[Mutation]:
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Assert):
            return
        if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
            yield from between(node.left, node.right, OPERATORS[type(node.op)])
        elif isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in COMPARISONS:
            yield from between(node.left, node.comparators[0], COMPARISONS[type(node.ops[0])])
        elif isinstance(node, ast.Constant) and type(node.value) in (bool, int, float):
            begin = starts[node.lineno - 1] + node.col_offset
            end = starts[node.end_lineno - 1] + node.end_col_offset
            changed = (not node.value) if isinstance(node.value, bool) else node.value + 1
            yield Mutation(path, begin, end, repr(changed))
        for name, value in ast.iter_fields(node):
            if name not in ("annotation", "returns"):
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST):
                        yield from visit(child)

    yield from visit(ast.parse(source))


def tests_of(path: Path) -> list[str]:
    """The tests of the room that a file belongs to: the deepest folder of tests that mirrors its own."""
    parts = path.relative_to(ROOT / "plr_jax").with_suffix("").parts
    for depth in range(len(parts), 0, -1):
        folder = ROOT / "tests" / Path(*parts[:depth])
        if folder.is_dir():
            return [str(folder.relative_to(ROOT))]
    file = ROOT / "tests" / f"test_{parts[0].strip('_')}.py"
    return [str(file.relative_to(ROOT))] if file.exists() else ["tests"]


def is_noticed(mutation: Mutation, tests: list[str]) -> bool:
    """Whether tests fail, or take too long, on a copy that is changed."""
    with tempfile.TemporaryDirectory() as folder:
        for name in ("plr_jax", "tests", "experiments", "notebooks"):
            shutil.copytree(ROOT / name, Path(folder) / name, ignore=shutil.ignore_patterns("__pycache__"))
        for file in (*ROOT.glob("*.toml"), *ROOT.glob("*.md")):
            shutil.copy(file, folder)
        target = Path(folder) / mutation.path.relative_to(ROOT)
        source = target.read_bytes()
        target.write_bytes(source[: mutation.begin] + mutation.text.encode() + source[mutation.end :])
        command = [sys.executable, "-m", "pytest", "-n", "0", "-x", "-q", "-p", "no:cacheprovider", *tests]
        try:
            run = subprocess.run(command, check=False, cwd=folder, capture_output=True, text=True, timeout=SECONDS)
        except subprocess.TimeoutExpired:
            return True
        if run.returncode not in (0, 1, 4):  # passed, failed, or not even to be imported
            raise RuntimeError(f"The tests of {mutation.path} did not run: {run.stdout[-2000:]}{run.stderr[-2000:]}")
        return run.returncode != 0


def main() -> None:
    """Print what is not noticed, and the share of what is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--number", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--whole", action="store_true", help="run all tests on what the room's own do not notice")
    arguments = parser.parse_args()
    everything = [mutation for path in sorted((ROOT / "plr_jax").rglob("*.py")) for mutation in mutations_of(path)]
    noticed = 0
    for i, mutation in enumerate(random.Random(arguments.seed).sample(everything, arguments.number)):
        found = is_noticed(mutation, tests_of(mutation.path)) or (arguments.whole and is_noticed(mutation, ["tests"]))
        noticed += found
        if not found:
            source = mutation.path.read_bytes()
            line = source[: mutation.begin].count(b"\n") + 1
            was = source[mutation.begin : mutation.end].decode().strip()
            print(f"{mutation.path.relative_to(ROOT)}:{line}: {was} -> {mutation.text.strip()}", flush=True)
        print(f"{noticed} of {i + 1} noticed", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
