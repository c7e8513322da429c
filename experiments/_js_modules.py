"""Modules of JavaScript, run by Node: what they answer, and how long that takes."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
from jaxtyping import Float

_DRIVER = """
import { readFileSync, writeFileSync } from "node:fs";
const [module, name, ...numbers] = process.argv.slice(2);
const [dim, width, runs] = numbers.map(Number);
const answer = (await import(module))[name];
const bytes = readFileSync("points");
const points = new Float64Array(bytes.buffer, bytes.byteOffset, bytes.length / 8);
const count = points.length / dim, answers = new Float64Array(count * width), x = new Float64Array(dim);
const seconds = [];
for (let run = 0; run < runs; run++) {
    const began = process.cpuUsage().user;
    for (let i = 0; i < count; i++) {
        for (let axis = 0; axis < dim; axis++) x[axis] = points[i * dim + axis];
        const found = answer(x);
        if (width > 1) answers.set(found, i * width);
        else answers[i] = found;
    }
    seconds.push((process.cpuUsage().user - began) / 1e6);
}
writeFileSync("answers", new Uint8Array(answers.buffer));
console.log(JSON.stringify(seconds));
"""


class NodeModule:
    """What a module exports, for many points."""

    def __init__(self, text: str, folder: Path):
        """Of a module's text, which is written to a folder that is made if there is none."""
        self.folder = folder
        folder.mkdir(exist_ok=True)
        (folder / "module.mjs").write_text(text)
        (folder / "driver.mjs").write_text(_DRIVER)

    def __call__(self, x: Float[np.ndarray, "n dim"], name: str = "distance", width: int = 1, runs: int = 1):
        """What its function of that name answers, so many numbers a point: in 64 bits, ``(n, width)``."""
        self.seconds = self._run(x, name, width, runs)
        return np.fromfile(self.folder / "answers").reshape(len(x), width)

    def nanoseconds(self, x: Float[np.ndarray, "n dim"], runs: int = 9) -> float:
        """A distance, one after another: the median of several runs after those that compile."""
        return float(np.median(self._run(x, "distance", 1, runs)[2:])) / len(x) * 1e9

    def _run(self, x: np.ndarray, name: str, width: int, runs: int) -> list[float]:
        np.ascontiguousarray(x, np.float64).tofile(self.folder / "points")
        arguments = ["./module.mjs", name, str(x.shape[1]), str(width), str(runs)]
        done = subprocess.run(
            [node(), "driver.mjs", *arguments], cwd=self.folder, check=True, capture_output=True, text=True
        )
        return json.loads(done.stdout)


def node() -> str:
    """Node; raises ``RuntimeError`` if there is none."""
    found = shutil.which("node")
    if found is None:
        raise RuntimeError("This needs Node, as node.")
    return found
