"""Run an experiment from the command line: measure, write a results file, draw its pictures."""

import argparse
import json
import os
import platform
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import plr_jax
from experiments._tables import as_text

RESULTS = Path(__file__).parent / "results"
WHOLE = "whole"  # name of the part of an experiment that has no sections

_PACKAGES = ("plr-jax", "jax", "numpy", "scipy", "shapely", "networkx", "optax", "matplotlib")
_PACKAGES_OF_RIVALS = ("lightgbm", "numba", "ompl", "python-motion-planning", "scikit-fmm", "jupedsim")

Compute = Callable[[int, bool], dict[str, Any]]
Draw = Callable[[dict[str, Any], Path], list[Path]]


def no_pictures(results: dict[str, Any], output: Path) -> list[Path]:
    return []


class Section(NamedTuple):
    """A part of an experiment with its own measurement and, for some, pictures."""

    measure: Compute
    draw: Draw = no_pictures


def run(
    name: str,
    purpose: str | None,
    measured: Compute | Mapping[str, Section],
    draw: Draw = no_pictures,
    options: argparse.ArgumentParser | None = None,
) -> None:
    """Run one experiment from the command line: measure, write ``<name>.json``, draw from that file alone.

    Args:
        name: Name of the script, and of its results file.
        purpose: What ``--help`` says.
        measured: Function ``measure(seed, smoke)`` that returns results fit for JSON, or named sections with such
            functions. Each section is written as soon as it is measured; ``--only`` selects some.
        draw: Takes the results as read back and the output folder; returns the pictures it wrote. Sections have
            their own.
        options: A parser, without ``--help``, of more options, which ``measured`` reads.
    """
    is_divided = isinstance(measured, Mapping)
    sections = measured if is_divided else {WHOLE: Section(measured, draw)}
    arguments = _arguments(name, purpose, list(sections), options)
    output = arguments.output or (Path(tempfile.mkdtemp(prefix="plr_jax_")) if arguments.smoke else RESULTS)
    commit, today = commit_of_code(), date.today().isoformat()
    parts = () if arguments.draw else arguments.only or sections
    for part in parts:
        print(f"== {part}", flush=True)
        began = time.perf_counter()
        found = sections[part].measure(arguments.seed, arguments.smoke)
        about = {"commit": commit, "date": today, "minutes": round((time.perf_counter() - began) / 60, 1)}
        is_kept = is_divided and (output / f"{name}.json").exists()
        old = read(output, name) if is_kept else {"measured": {}, "results": {}}
        setting = {"smoke": arguments.smoke, "seed": arguments.seed}
        if is_kept and any(old[key] != value for key, value in setting.items()):
            raise SystemExit(f"Other sections have another --seed or --smoke: see {output}/{name}.json.")
        results = {**old["results"], part: found}
        record = {"experiment": name, **setting, **environment()}
        record["measured"] = {**old["measured"], part: about}
        record["results"] = {each: results[each] for each in sections if each in results} if is_divided else found
        print(f"wrote {write(output, name, record)}")
    results = read(output, name)["results"]
    print(as_text(results, name))
    for part, found in (results if is_divided else {WHOLE: results}).items():
        for path in sections[part].draw(found, output):
            print(f"wrote {path}")


def _arguments(
    name: str, purpose: str | None, sections: list[str], options: argparse.ArgumentParser | None
) -> argparse.Namespace:
    parents = [options] if options else []
    parser = argparse.ArgumentParser(prog=f"python -m experiments.{name}", description=purpose, parents=parents)
    parser.add_argument("--smoke", action="store_true", help="smallest setting: does it run at all?")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random (default: 0)")
    parser.add_argument("--draw", action="store_true", help="measure nothing; draw from the results file")
    parser.add_argument("--output", type=Path, help="results folder (default: experiments/results; new for --smoke)")
    parser.add_argument("--only", nargs="+", choices=sections, help="measure only these sections again")
    return parser.parse_args()


def commit_of_code(revision: str = "HEAD") -> str:
    """Return the commit of a revision; ``"unknown"`` outside a clone.

    ``HEAD`` is the commit checked out, with a plus if tracked code differs from it.
    """

    def git(*words: str) -> subprocess.CompletedProcess:
        return subprocess.run(["git", *words], cwd=RESULTS, capture_output=True, text=True, check=False)

    commit = git("rev-parse", "--short=8", revision)
    changed = (
        revision == "HEAD"
        and git("diff", "--quiet", "HEAD", "--", ":(top)plr_jax", ":(top,glob)experiments/**/*.py").returncode
    )
    return commit.stdout.strip() + ("+" if changed else "") if commit.returncode == 0 else "unknown"


def environment() -> dict[str, Any]:
    """Return versions, device, number of cores and number types."""
    import jax

    def version_of(package: str) -> str:
        try:
            return version(package) if package != "plr-jax" else plr_jax.__version__
        except PackageNotFoundError:
            return "not installed"

    versions = {package: version_of(package) for package in _PACKAGES + _PACKAGES_OF_RIVALS}
    return {
        "versions": {"python": platform.python_version(), **versions},
        "system": f"{platform.system()} {platform.machine()}",
        "device": jax.devices()[0].device_kind,
        "cores": os.cpu_count(),
        "dtype": {"oracle": "float64", "points": "float64", "query": str(np.asarray(jax.numpy.zeros(1)).dtype)},
    }


def write(output: Path, name: str, record: dict[str, Any]) -> Path:
    """Write ``<name>.json`` into a folder, which is made if it is missing."""
    output.mkdir(parents=True, exist_ok=True)
    path = output / f"{name}.json"
    path.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return path


def read(output: Path, name: str) -> dict[str, Any]:
    """Return the record that :func:`write` wrote."""
    return json.loads((output / f"{name}.json").read_text(encoding="utf-8"))
