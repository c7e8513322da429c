"""Helpers for tests of pages: find the examples of a Markdown page, and run them."""

import ast
import io
import re
import shlex
import sys
from pathlib import Path

import pytest

from plr_jax.cli import main

# A statement that contains one of these texts takes over a second, mostly in the compiler of XLA. The quick tier
# leaves out the statement, and all that need its result; the full tier runs everything.
SLOW = (
    "solve_eikonal(cost.space(",
    "solve_eikonal(space, ",
    "solve_eikonal(volume, ",
    "solve_eikonal(plane, ",
    "solve_eikonal(body, ",
    "solve_eikonal(arm, ",
    "solve_eikonal(ball, ",
    "print(on_grid(",
    "print(jax.grad(length)(",
    "print(jax.grad(between)(",
    "shifts, state, cost = step(shifts, state)",
    "print(steps.window(",
    "jax.vmap(rewards)(",
    "maps = jax.random.bernoulli(",
    "pool = jax.vmap(reset)(",
    "cost_distance(minutes_a_meter, clinics, cell_size=30, bounds=True)",
    "cost_distance(minutes_a_meter, clinics, cell_size=30, max_bytes=8192)",
)
# Smaller budgets of bytes in the quick tier.
SMALLER = {
    "max_bytes=1024": "max_bytes=512",
    "--max-bytes 8192": "--max-bytes 512",
    "--leaf cone --output exits.plr": "--leaf cone --max-bytes 512 --output exits.plr",
}


def blocks(page: str, language: str) -> list[str]:
    """Return the fenced blocks of a language, in their order."""
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


def run_page(page: str, folder: Path, is_quick: bool) -> dict[str, object]:
    """Run the Python and shell blocks of a page from top to bottom; return the variables of Python.

    Lines of shell blocks that do not call ``plr-jax``, or make an environment, are left out.
    """
    names: dict[str, object] = {"__name__": "page"}
    missing: set[str] = set()
    for text, smaller in SMALLER.items() if is_quick else ():
        page = page.replace(text, smaller)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for language, code in re.findall(r"```(python|sh)\n(.*?)```", page, re.DOTALL):
            if language == "python":
                run_python(code, names, missing, SLOW if is_quick else ())
                continue
            for command in code.splitlines():
                if "plr-jax" in command and "venv" not in command:
                    run_command(command)
    return names


def run_python(code: str, names: dict[str, object], missing: set[str], slow: tuple[str, ...]) -> None:
    """Run a block of Python without slow statements and those that need their names, for samples of 16 points.

    Args:
        code: The block.
        names: The variables, which are updated.
        missing: The names that statements left out would have bound, which are updated.
        slow: Texts of the statements to leave out.
    """
    code = re.sub(r"(sample_free\()[\d_]+", r"\g<1>16", code)
    for statement in ast.parse(code).body:
        is_slow = any(text in (ast.get_source_segment(code, statement) or "") for text in slow)
        if not propagate(statement, missing, is_slow):
            exec(compile(ast.Module([statement], []), "page", "exec"), names)


def propagate(statement: ast.stmt, tainted: set[str], is_tainted: bool = False) -> bool:
    """Return whether a statement is tainted, itself or by a name that it reads.

    The names that a tainted statement binds become tainted; those that another statement binds are so no longer.
    """
    nodes = list(ast.walk(statement))
    targets = [each.target for each in nodes if isinstance(each, ast.comprehension)]
    own = {node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)}
    names = [node for node in nodes if isinstance(node, ast.Name) and node.id not in own]
    loads = {name.id for name in names if isinstance(name.ctx, ast.Load)}
    stores = {name.id for name in names if isinstance(name.ctx, ast.Store)}
    stores |= {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    is_tainted = is_tainted or bool(loads & tainted)
    tainted -= stores
    tainted |= stores if is_tainted else set()
    return is_tainted


def run_command(command: str) -> None:
    """Run a line ``[echo "..." |] plr-jax ...`` of a shell in this process."""
    echo, _, program = command.rpartition("|")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(f"{''.join(shlex.split(echo)[1:])}\n".encode())))
        patch.setattr(sys, "argv", shlex.split(program))
        assert sys.argv[0] == "plr-jax", command
        with pytest.raises(SystemExit) as end:
            main()
        assert not end.value.code, command
