"""Measure how many random changes of the package the tests notice.

``python tests/mutations.py --number 200 --seed 0 --lines FOLDER`` works in three steps:

1. Run each test file once, and store its duration and the lines of the package that it runs in FOLDER.
2. Draw operators, comparisons and constants of ``plr_jax``, and change one at a time in a copy.
3. Run the test files that run the changed line, first those of the same room, then the faster ones.

A change that no test notices is printed: either it is equivalent to the original, or a test is missing. ``--quick``
uses only the quick tier of the tests; it needs a FOLDER of its own.
"""

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import coverage

ROOT = Path(__file__).parent.parent
OPERATORS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "*", ast.Pow: "*"}
COMPARISONS = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="}
PYTEST = ["-m", "pytest", "-n", "0", "-x", "-q", "-p", "no:cacheprovider", "-m"]
ALL, QUICK = "full or not full", "not full"
NO_TESTS = 5  # exit status of pytest if no test of a file belongs to the tier
SECONDS = 120  # test files are chosen for each change until their durations sum to this
LONGEST = 900  # seconds after which tests hang, so that the change counts as noticed


class Mutation(NamedTuple):
    """A replacement of the bytes from ``begin`` to ``end`` of a file by ``text``."""

    path: Path
    begin: int
    end: int
    text: str


def mutations_of(path: Path) -> Iterator[Mutation]:
    """Yield all single changes of a file, except in annotations, error messages and strings."""
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


class TestFile(NamedTuple):
    """A test file, its duration, and the lines of each package file that it runs."""

    name: str
    seconds: float
    lines: dict[str, list[int]]


def test_files(folder: Path, tier: str) -> list[TestFile]:
    """Return all test files with their durations and lines; run those that the folder does not have yet."""
    folder.mkdir(exist_ok=True)
    names = [str(path.relative_to(ROOT)) for path in sorted((ROOT / "tests").rglob("test_*.py"))]
    result = []
    for name in names:
        kept = folder / (name.replace("/", "_") + ".json")
        if not kept.exists():
            data, begin = folder / "data", time.monotonic()
            command = [sys.executable, "-m", "coverage", "run", "--source=plr_jax", f"--data-file={data}"]
            command += [*PYTEST, tier, name]
            run = subprocess.run(command, check=False, cwd=ROOT, capture_output=True, text=True)
            if run.returncode not in (0, NO_TESTS):
                raise RuntimeError(f"{name} fails without any change: {run.stdout[-2000:]}{run.stderr[-2000:]}")
            ran = coverage.CoverageData(str(data))
            ran.read()
            lines = {str(Path(file).relative_to(ROOT)): ran.lines(file) for file in ran.measured_files()}
            lines = lines if run.returncode == 0 else {}
            kept.write_text(json.dumps(TestFile(name, time.monotonic() - begin, lines)))
            print(f"{name}: {time.monotonic() - begin:.0f} s", file=sys.stderr, flush=True)
        result.append(TestFile(*json.loads(kept.read_text())))
    return result


@cache
def lines_in_functions(path: Path) -> set[int]:
    """Return the lines that run when functions are called, not at import."""
    functions = [n for n in ast.walk(ast.parse(path.read_bytes())) if isinstance(n, ast.FunctionDef | ast.Lambda)]
    return {
        line
        for function in functions
        for body in (function.body if isinstance(function.body, list) else [function.body])
        for line in range(body.lineno, body.end_lineno + 1)
    }


def line_of(mutation: Mutation) -> int:
    return mutation.path.read_bytes()[: mutation.begin].count(b"\n") + 1


def tests_of(mutation: Mutation, files: list[TestFile]) -> list[str]:
    """Return test files, within the time limit, that run the changed line (or its module, if only imports run it)."""
    name = str(mutation.path.relative_to(ROOT))
    called = lines_in_functions(mutation.path)
    asked = {line_of(mutation)} if line_of(mutation) in called else called
    room = Path(name).with_suffix("").parts[1:]

    def rooms_apart(file: TestFile) -> int:
        mirrored = Path(file.name.replace("test_", "")).with_suffix("").parts[1:]
        return -sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(room, mirrored, strict=False)))

    ran = [file for file in files if asked & set(file.lines.get(name, ()))]
    chosen, left = [], float(SECONDS)
    for file in sorted(ran, key=lambda file: (rooms_apart(file), file.seconds)):
        if not chosen or file.seconds <= left:
            chosen.append(file.name)
            left -= file.seconds
    return chosen


def is_noticed(mutation: Mutation, tests: list[str], tier: str) -> bool:
    """Return whether tests fail, or hang, on a copy with the change."""
    if not tests:
        return False
    with tempfile.TemporaryDirectory() as folder:
        for name in ("plr_jax", "tests", "experiments", "notebooks"):
            shutil.copytree(ROOT / name, Path(folder) / name, ignore=shutil.ignore_patterns("__pycache__"))
        for file in (*ROOT.glob("*.toml"), *ROOT.glob("*.md")):
            shutil.copy(file, folder)
        target = Path(folder) / mutation.path.relative_to(ROOT)
        source = target.read_bytes()
        target.write_bytes(source[: mutation.begin] + mutation.text.encode() + source[mutation.end :])
        command, environment = [sys.executable, *PYTEST, tier, *tests], {**os.environ, "PYTHONPATH": folder}
        try:
            run = subprocess.run(
                command, check=False, cwd=folder, env=environment, capture_output=True, text=True, timeout=LONGEST
            )
        except subprocess.TimeoutExpired:
            return True
        if run.returncode in (3, NO_TESTS):  # 3: internal error of pytest
            raise RuntimeError(f"The tests of {mutation.path} did not run: {run.stdout[-2000:]}{run.stderr[-2000:]}")
        return run.returncode != 0


def main() -> None:
    """Print the changes that no test notices, and the share that tests notice."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--number", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--lines", type=Path, required=True, help="folder that keeps which lines tests run")
    parser.add_argument("--quick", action="store_true", help="use the quick tier alone")
    arguments = parser.parse_args()
    tier = QUICK if arguments.quick else ALL
    files = test_files(arguments.lines, tier)
    everything = [mutation for path in sorted((ROOT / "plr_jax").rglob("*.py")) for mutation in mutations_of(path)]
    noticed = 0
    for i, mutation in enumerate(random.Random(arguments.seed).sample(everything, arguments.number)):
        tests = tests_of(mutation, files)
        found = is_noticed(mutation, tests, tier)
        noticed += found
        if not found:
            was = mutation.path.read_bytes()[mutation.begin : mutation.end].decode().strip()
            where = f"{mutation.path.relative_to(ROOT)}:{line_of(mutation)}"
            print(f"{where}: {was} -> {mutation.text.strip()} ({len(tests)} files ran it)", flush=True)
        print(f"{noticed} of {i + 1} noticed", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
