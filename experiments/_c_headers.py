"""Headers of C, compiled: how large their code is, what they answer, and how long that takes."""

import ctypes
import re
import shutil
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from plr_jax import PLR
from plr_jax.plr.portable.numpy import NumpyPLR

STRICT = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow", "-Wdouble-promotion"]
STRICT += ["-ffp-contract=off"]
"""Options with which headers compile, as C99 and as C++."""
_C99 = ["-std=c99", *STRICT]
_RUNS = 5


class CompiledHeader:
    """A header's ``float NAME_distance(const REAL x[dim])``, and its waypoints if it has some, for many points.

    Attributes:
        real: The type of coordinates of NumPy.
        library: The compiled program.
    """

    def __init__(self, text: str, name: str, real: type[np.float32] | type[np.float64], dim: int, folder: Path):
        """Compiles a header whose definitions begin with a name, in a folder that is made if there is none."""
        self.real, of_c = real, _name_of(real)
        folder.mkdir(exist_ok=True)
        calls = {"distances": ("float", f"y[i] = {name}_distance(x + {dim} * i);")}
        if f"{name}_waypoint(" in text:
            calls["waypoints"] = (of_c, f"{name}_waypoint(x + {dim} * i, y + {dim} * i);")
        code = [text]
        for function, (of_answers, call) in calls.items():
            signature = f"void {function}(const {of_c} *x, {of_answers} *y, uint32_t n)"
            code += [f"{signature};", signature, "{", "    for (uint32_t i = 0; i < n; ++i) {", f"        {call}"]
            code += ["    }", "}"]
        self.library = compiled_library("\n".join(code) + "\n", folder)

    def __call__(self, x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, " n"]:
        return self._answers(self.library.distances, x, np.empty(len(x), np.float32))

    def waypoints(self, x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n dim"]:
        """Where to go from each point."""
        return self._answers(self.library.waypoints, x, np.empty(x.shape, self.real))

    def _answers(self, function, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        x = np.ascontiguousarray(x, self.real)
        function(ctypes.c_void_p(x.ctypes.data), ctypes.c_void_p(y.ctypes.data), ctypes.c_uint32(len(x)))
        return y

    def nanoseconds(self, x: Float[np.ndarray, "n dim"]) -> float:
        """A point, one after another: the median of several runs."""
        x = np.ascontiguousarray(x, self.real)
        return median_seconds(lambda: self(x)) / len(x) * 1e9


def compiler() -> str:
    """The C compiler; raises ``RuntimeError`` if there is none."""
    found = shutil.which("cc")
    if found is None:
        raise RuntimeError("This needs a C compiler called cc.")
    return found


def compiled_library(code: str, folder: Path) -> ctypes.CDLL:
    """A program of C99, compiled in a folder."""
    (folder / "many.c").write_text(code)
    library = folder / "many.so"
    options = [*_C99, "-O2", "-shared", "-fPIC"]
    subprocess.run([compiler(), *options, str(folder / "many.c"), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def compiled_header(plr: PLR | NumpyPLR, folder: Path, compact: bool = False) -> CompiledHeader:
    """The header of a PLR."""
    text = plr.c_header("here", compact)
    return CompiledHeader(text, "here", _type_of(text), plr.dim, folder)


def object_for_size(plr: PLR | NumpyPLR, folder: Path, compact: bool = False, command: Sequence[str] = ()) -> Path:
    """The object file of a program that uses a header, compiled for size; the use of the stack is beside it.

    ``command`` is a compiler with options; without it, the C compiler of this machine.
    """
    folder.mkdir(exist_ok=True)
    text = plr.c_header("here", compact)
    real = _name_of(_type_of(text))
    functions = [f"float f(const {real} *x);\nfloat f(const {real} *x) {{ return here_distance(x); }}\n"]
    if "here_waypoint(" in text:
        arguments = f"const {real} *x, {real} *way"
        functions.append(f"void g({arguments});\nvoid g({arguments}) {{ here_waypoint(x, way); }}\n")
    (folder / "size.c").write_text(text + "".join(functions))
    compiled = folder / "size.o"
    options = ["-Os", "-fstack-usage", "-c", str(folder / "size.c"), "-o", str(compiled)]
    subprocess.run([*(command or [compiler()]), *_C99, *options], check=True)
    return compiled


def section_bytes(compiled: Path) -> dict[str, int]:
    """Bytes of code and of data of an object file."""
    listed = subprocess.run(["size", "-A", str(compiled)], check=True, capture_output=True, text=True).stdout
    found = {
        part: sum(map(int, re.findall(rf"^\.{part}\S*\s+(\d+)", listed, re.MULTILINE)))
        for part in ("text", "rodata", "data", "bss")
    }
    return {"code": found.pop("text"), "data": sum(found.values())}


def stack_bytes(compiled: Path) -> int:
    """Bytes of the stack that the functions of an object file take, as if each called the next."""
    return sum(int(line.split("\t")[1]) for line in compiled.with_suffix(".su").read_text().splitlines())


def median_seconds(call, runs: int = _RUNS) -> float:
    """Seconds of the processor that a call takes, the median of several."""
    seconds = []
    for _ in range(runs):
        began = time.process_time()
        call()
        seconds.append(time.process_time() - began)
    return float(np.median(seconds))


def _type_of(header: str) -> type[np.float32] | type[np.float64]:
    """Of the coordinates of a header's points."""
    return np.float64 if "const double x[" in header else np.float32


def _name_of(real: type[np.float32] | type[np.float64]) -> str:
    return "double" if real is np.float64 else "float"
