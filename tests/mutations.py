"""Measure how many random changes of the package the tests notice.

``python tests/mutations.py --number 200 --seed 0 --lines FOLDER`` works in three steps:

1. Run each test file once, and store in FOLDER how long each test takes and which lines of the package it runs.
2. Draw operators, comparisons and constants of ``plr_jax``, and change one at a time in a copy.
3. Run tests that run the changed line: first those of the quick tier, then those of the full tier.

Step 1 is done again if the folder was made for another commit, so measure a clean checkout. Changes that the quick
tier does not notice are printed. If no tier notices a change, the change is equivalent to the original, a test is
missing or was beyond the limits, or only child processes run the line. ``--within plr_jax/pairs --tests tests/pairs``
measures a part of the package. ``--control`` makes no change, so that no test should fail.

Steps 1 and 3 run pytest with this file as a plugin.
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
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import coverage
import pytest

ROOT = Path(__file__).parent.parent
OPERATORS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "*", ast.Pow: "*"}
COMPARISONS = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="}
PYTEST = ["-m", "pytest", "-n", "0", "-q", "-p", "mutations", "-p", "no:cacheprovider", "-m", "full or not full"]
PROCESSES = os.cpu_count() or 1
NO_TESTS = 5  # exit status of pytest if it runs no test of a file, such as one whose library is absent
TIER_SECONDS = 40  # of tests a change and tier; a test that would exceed this is skipped, except the first
MAX_TEST_FILES = 12  # a change and tier: collecting a file takes time, too
PYTEST_TIMEOUT = 300  # seconds; a run of pytest that takes longer counts as noticed


class Mutation(NamedTuple):
    """A replacement of the bytes from ``begin`` to ``end`` of a file by ``text``."""

    path: Path
    begin: int
    end: int
    text: str


class Test(NamedTuple):
    """A test function in one tier: its duration over the parameters of this tier, and the package lines it runs.

    A function that has parameters in both tiers makes two tests.
    """

    name: str
    is_quick: bool
    seconds: float
    lines: dict[str, list[int]]

    @property
    def file(self) -> str:
        return self.name.split("::")[0]


# The plugin. In step 1, it tells coverage which test runs. In step 3, it keeps the chosen tests, in their order.


def function_of(item: pytest.Item) -> str:
    return item.nodeid.split("[")[0]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    measured = coverage.Coverage.current()
    if measured is None:
        return (yield)
    is_quick = item.get_closest_marker("full") is None
    measured.switch_context(f"{function_of(item)} {is_quick}")
    begin = time.monotonic()
    result = yield
    with open(os.environ["MUTATIONS_SECONDS"], "a") as file:
        file.write(json.dumps([function_of(item), is_quick, time.monotonic() - begin]) + "\n")
    return result


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    tier, *chosen = json.loads(os.environ.get("MUTATIONS_CHOSEN", "[null]"))
    if tier is not None:
        place = {name: i for i, name in enumerate(chosen)}
        is_full = tier == "full"
        items[:] = [i for i in items if function_of(i) in place and bool(i.get_closest_marker("full")) == is_full]
        items.sort(key=lambda item: place[function_of(item)])


# Step 1: which lines each test runs.


def tests_of_file(path: Path, folder: Path) -> list[Test]:
    """Return the tests of a file; run them if the folder does not have the file yet."""
    name = str(path.relative_to(ROOT))
    kept = folder / (name.replace("/", "_") + ".json")
    if not kept.exists():
        data, seconds = kept.with_suffix(".data"), kept.with_suffix(".seconds")
        command = [sys.executable, "-m", "coverage", "run", "--source=plr_jax", f"--data-file={data}", *PYTEST, name]
        seconds.write_text("")
        environment = {**os.environ, "MUTATIONS_SECONDS": str(seconds)}
        run = subprocess.run(command, check=False, cwd=ROOT, env=environment, capture_output=True, text=True)
        if run.returncode not in (0, NO_TESTS):
            raise RuntimeError(f"{name} fails without any change: {run.stdout[-2000:]}{run.stderr[-2000:]}")
        ran = coverage.CoverageData(str(data))
        ran.read()
        durations: dict[tuple[str, bool], float] = {}
        for line in seconds.read_text().splitlines():
            *test, duration = json.loads(line)
            durations[tuple(test)] = durations.get(tuple(test), 0.0) + duration
        tests = []
        for (test, is_quick), duration in durations.items():
            ran.set_query_context(f"{test} {is_quick}")
            files = {str(Path(file).relative_to(ROOT)): ran.lines(file) or [] for file in ran.measured_files()}
            tests.append(Test(test, is_quick, duration, {file: lines for file, lines in files.items() if lines}))
        kept.write_text(json.dumps(tests))
        data.unlink(missing_ok=True)  # coverage writes none if no test runs
        seconds.unlink()
        print(f"{name}: {sum(durations.values()):.0f} s", file=sys.stderr, flush=True)
    return [Test(*test) for test in json.loads(kept.read_text())]


# Step 2: changes of the package.


def mutations_of(path: Path) -> Iterator[Mutation]:
    """Yield changes of simple operators, comparisons and constants.

    Annotations, f-strings, ``raise`` and ``assert`` statements are left out.
    """
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
            next_value = node.value + 1 if node.value + 1 != node.value else 2 * node.value
            changed = (not node.value) if isinstance(node.value, bool) else next_value
            yield Mutation(path, begin, end, repr(changed))
        for name, value in ast.iter_fields(node):
            if name not in ("annotation", "returns"):
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST):
                        yield from visit(child)

    yield from visit(ast.parse(source))


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


# Step 3: whether tests notice a change.


def chosen_tests(mutation: Mutation, tests: list[Test]) -> list[str]:
    """Return tests of the files that run the changed line, or any line of its module if only imports run it.

    Tests that run the line come first, of them those of the same room, then faster ones. The other tests of these
    files follow, since a fixture or a cache may have run the line before.
    """
    name = str(mutation.path.relative_to(ROOT))
    called = lines_in_functions(mutation.path)
    asked = {line_of(mutation)} if line_of(mutation) in called else called
    room = Path(name.replace("/_", "/")).with_suffix("").parts[1:]

    def order(test: Test) -> tuple[bool, int, float]:
        mirrored = Path(test.file.replace("test_", "")).with_suffix("").parts[1:]
        shared = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(room, mirrored, strict=False)))
        return not asked & set(test.lines.get(name, ())), -shared, test.seconds

    files: dict[str, None] = {}
    for test in sorted(tests, key=order):
        if not order(test)[0] and len(files) < MAX_TEST_FILES:
            files[test.file] = None
    chosen, left = [], float(TIER_SECONDS)
    for test in sorted((test for test in tests if test.file in files), key=order):
        if not chosen or test.seconds <= left:
            chosen.append(test.name)
            left -= test.seconds
    return chosen


def is_noticed(folder: str, tier: str, chosen: list[str]) -> bool:
    """Return whether the chosen tests of a tier fail, or hang, on the changed copy in a folder."""
    if not chosen:
        return False
    environment = {
        **os.environ,
        "PYTHONPATH": folder,
        "MUTATIONS_CHOSEN": json.dumps([tier, *chosen]),
        "JAX_COMPILATION_CACHE_DIR": str(Path(tempfile.gettempdir()) / "plr_jax_mutations"),
    }
    command = [sys.executable, *PYTEST, "-x", *dict.fromkeys(name.split("::")[0] for name in chosen)]
    try:
        run = subprocess.run(
            command, check=False, cwd=folder, env=environment, capture_output=True, text=True, timeout=PYTEST_TIMEOUT
        )
    except subprocess.TimeoutExpired:
        return True
    return run.returncode not in (0, NO_TESTS)  # a crash, or a test file that cannot be imported, is noticed, too


@cache
def tracked_names() -> list[str]:
    """Return the files and folders at the top level that git knows."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True)
    return sorted({Path(file).parts[0] for file in listed.stdout.splitlines() if (ROOT / file).exists()})


def noticed_by(mutation: Mutation, tests: list[Test]) -> str:
    """Return which tier notices a change: "quick", "full" or "none"."""
    with tempfile.TemporaryDirectory() as folder:
        for name in tracked_names():  # with the times of files, so that Python does not compile them again
            copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy2
            copy(ROOT / name, Path(folder) / name)
        target = Path(folder) / mutation.path.relative_to(ROOT)
        source = target.read_bytes()
        target.write_bytes(source[: mutation.begin] + mutation.text.encode() + source[mutation.end :])
        for tier in ("quick", "full"):
            of_tier = [test for test in tests if test.is_quick == (tier == "quick")]
            if is_noticed(folder, tier, chosen_tests(mutation, of_tier)):
                return tier
    return "none"


def main() -> None:
    """Print the changes that only the full tier or no test notices, and the shares of both tiers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--number", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--lines", type=Path, required=True, help="folder that keeps which lines tests run")
    parser.add_argument("--within", type=Path, default=ROOT / "plr_jax", help="the folder of the package to change")
    parser.add_argument("--tests", type=Path, default=ROOT / "tests", help="the folder of tests to run")
    parser.add_argument("--control", action="store_true", help="change nothing, to see that tests pass in copies")
    arguments = parser.parse_args()
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, check=True, capture_output=True, text=True)
    arguments.lines = arguments.lines.resolve() / commit.stdout.strip()
    arguments.lines.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(PROCESSES) as threads:
        paths = sorted(arguments.tests.resolve().rglob("test_*.py"), key=lambda path: -path.stat().st_size)
        found = threads.map(lambda path: tests_of_file(path, arguments.lines), paths)
        tests = [test for of_file in found for test in of_file]
        changed = sorted(arguments.within.resolve().rglob("*.py"))
        everything = [mutation for path in changed for mutation in mutations_of(path)]
        drawn = random.Random(arguments.seed).sample(everything, min(arguments.number, len(everything)))
        if arguments.control:
            drawn = [mutation._replace(end=mutation.begin, text="") for mutation in drawn]
        count = {"quick": 0, "full": 0, "none": 0}
        for mutation, tier in zip(drawn, threads.map(lambda each: noticed_by(each, tests), drawn), strict=True):
            count[tier] += 1
            if tier != "quick":
                was = mutation.path.read_bytes()[mutation.begin : mutation.end].decode().strip()
                where = f"{mutation.path.relative_to(ROOT)}:{line_of(mutation)}"
                print(f"{where}: {was} -> {mutation.text.strip()} (noticed by: {tier})", flush=True)
            print(count, file=sys.stderr, flush=True)
    noticed = count["quick"] + count["full"]
    print(f"noticed: {noticed} of {len(drawn)}, {noticed / max(len(drawn), 1):.0%}")
    print(f"of these by the quick tier: {count['quick']} of {noticed}, {count['quick'] / max(noticed, 1):.0%}")


if __name__ == "__main__":
    main()
