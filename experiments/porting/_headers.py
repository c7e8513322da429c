"""Headers of C, compiled: how large their code is, what they answer, and how long that takes."""

import ctypes
import re
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
from jaxtyping import Float

from plr_jax import PLR

_STRICT = ["-Wall", "-Wextra", "-Werror", "-std=c99", "-ffp-contract=off"]
_RUNS = 5


class CompiledFunction:
    """A C function ``float f(const REAL x[dim])``, called for many points.

    Attributes:
        real: The type of coordinates of NumPy.
    """

    def __init__(self, definition: str, call: str, real: type[np.float32] | type[np.float64], dim: int, folder: Path):
        self.real, self._name = real, "double" if real is np.float64 else "float"
        (folder / "here.h").write_text(definition)
        (folder / "many.c").write_text(
            f'#include "here.h"\n'
            f"void many(const {self._name} *x, float *y, uint32_t n);\n"
            f"void many(const {self._name} *x, float *y, uint32_t n)\n{{\n"
            f"    for (uint32_t i = 0; i < n; ++i) {{\n        y[i] = {call}(x + {dim} * i);\n    }}\n}}\n"
        )
        library = folder / "many.so"
        options = [*_STRICT, "-O2", "-shared", "-fPIC", "-I", str(folder)]
        subprocess.run([compiler(), *options, str(folder / "many.c"), "-o", str(library), "-lm"], check=True)
        self.library = ctypes.CDLL(str(library))

    def __call__(self, x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
        x, y = np.ascontiguousarray(x, self.real), np.empty(len(x), np.float32)
        self.library.many(ctypes.c_void_p(x.ctypes.data), ctypes.c_void_p(y.ctypes.data), ctypes.c_uint32(len(x)))
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


def compiled_header(plr: PLR, folder: Path) -> CompiledFunction:
    """The distances of a PLR's header."""
    folder.mkdir(exist_ok=True)
    text = plr.c_header("here")
    real = np.float64 if "const double x[" in text else np.float32
    return CompiledFunction(text, "here_distance", real, plr.dim, folder)


def section_bytes(plr: PLR, folder: Path) -> dict[str, int]:
    """Bytes of code and of constant data of a header whose functions a program uses, compiled for size."""
    folder.mkdir(exist_ok=True)
    text = plr.c_header("here")
    real = "double" if "const double x[" in text else "float"
    functions = [f"float f(const {real} *x);\nfloat f(const {real} *x) {{ return here_distance(x); }}\n"]
    if "here_waypoint(" in text:
        arguments = f"const {real} *x, {real} *way"
        functions.append(f"void g({arguments});\nvoid g({arguments}) {{ here_waypoint(x, way); }}\n")
    (folder / "size.c").write_text(text + "".join(functions))
    compiled = str(folder / "size.o")
    subprocess.run([compiler(), *_STRICT, "-Os", "-c", str(folder / "size.c"), "-o", compiled], check=True)
    listed = subprocess.run(["size", "-A", compiled], check=True, capture_output=True, text=True).stdout
    found = {
        part: sum(map(int, re.findall(rf"^\.{part}\S*\s+(\d+)", listed, re.MULTILINE))) for part in ("text", "rodata")
    }
    return {"code": found["text"], "data": found["rodata"]}


def median_seconds(call, runs: int = _RUNS) -> float:
    """Seconds of the processor that a call takes, the median of several."""
    seconds = []
    for _ in range(runs):
        began = time.process_time()
        call()
        seconds.append(time.process_time() - began)
    return float(np.median(seconds))
