"""What every experiment shares: its command line, its results file, and the record of where it ran."""

import argparse
import json
import os
import platform
import tempfile
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

RESULTS = Path(__file__).parent / "results"

_PACKAGES = (
    "plr-jax",
    "jax",
    "numpy",
    "scipy",
    "shapely",
    "networkx",
    "optax",
    "matplotlib",
    "interpax",
    "lightgbm",
    "numba",
    "ompl",
    "scikit-fmm",
)

Compute = Callable[[int, bool], dict[str, Any]]
Draw = Callable[[dict[str, Any], Path], list[Path]]
Renew = Callable[[dict[str, Any], str], dict[str, Any]]


def run(name: str, purpose: str, compute: Compute, draw: Draw, renew: Renew | None = None) -> None:
    """Run one experiment from the command line: compute, write ``<name>.json``, draw from that file alone.

    Args:
        name: Name of the script, and of its results file.
        purpose: What ``--help`` says.
        compute: Takes the seed and whether this is the smallest setting; gives results fit for JSON.
        draw: Takes the results as read back and the output folder; gives the files it wrote.
        renew: Takes results and the name of a part; gives results with that part measured again.
    """
    parser = command_line(name, purpose)
    if renew is not None:
        parser.add_argument("--only", metavar="PART", help="measure one part again, and keep the others as they are")
    arguments = parser.parse_args()
    output = output_folder(arguments)
    if not arguments.draw:
        if renew is not None and arguments.only is not None:
            results = renew(read(output, name)["results"], arguments.only)
        else:
            results = compute(arguments.seed, arguments.smoke)
        record = {"experiment": name, "smoke": arguments.smoke, "seed": arguments.seed, **environment()}
        print(f"wrote {write(output, name, {**record, 'results': results})}")
    for path in draw(read(output, name)["results"], output):
        print(f"wrote {path}")


def command_line(name: str, purpose: str | None) -> argparse.ArgumentParser:
    """The options that every experiment has."""
    parser = argparse.ArgumentParser(prog=f"python -m experiments.{name}", description=purpose)
    parser.add_argument("--smoke", action="store_true", help="smallest setting: does it run at all?")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random (default: 0)")
    parser.add_argument("--draw", action="store_true", help="compute nothing; draw from the results file")
    parser.add_argument(
        "--output", type=Path, help="folder of the results (default: experiments/results; a new one for --smoke)"
    )
    return parser


def output_folder(arguments: argparse.Namespace) -> Path:
    """Where results go. The smallest setting must never replace results that are committed."""
    return arguments.output or (Path(tempfile.mkdtemp(prefix="plr_jax_")) if arguments.smoke else RESULTS)


def environment() -> dict[str, Any]:
    """Where results come from: versions, device, cores, number types."""
    import jax

    return {
        "versions": {"python": platform.python_version(), **{package: _version(package) for package in _PACKAGES}},
        "system": f"{platform.system()} {platform.machine()}",
        "device": jax.devices()[0].device_kind,
        "cores": os.cpu_count(),
        "dtype": {"oracle": "float64", "points": "float64", "query": str(np.asarray(jax.numpy.zeros(1)).dtype)},
    }


def write(output: Path, name: str, record: dict[str, Any]) -> Path:
    """Write ``<name>.json`` into a folder, made where missing."""
    output.mkdir(parents=True, exist_ok=True)
    path = output / f"{name}.json"
    path.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return path


def read(output: Path, name: str) -> dict[str, Any]:
    """The record that :func:`write` wrote."""
    return json.loads((output / f"{name}.json").read_text(encoding="utf-8"))


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
