"""Distance functions in JavaScript: bits and speed in Node and Chromium; pages: bytes, redraws, damaged files."""

import re
import sys
import tempfile
from base64 import b64encode
from importlib import import_module
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from experiments import portable
from experiments._browser import IS_DRAWN, IS_OPEN, Browser, axe_core
from experiments._js_modules import NodeModule
from experiments._runner import Section, run
from experiments.benchmarks._maps import load_maps
from plr_jax import PLR, Box, PairPLR, VisibilityGraph, construct, construct_pairs, plot, scenes

NUM_POINTS, CHUNK, NUM_FILES = 1_000_000, 100_000, 2_000
PAIR_BYTES, CONE_BYTES = {"maze": 1_024, "arena": 16_384}, 1_024
_WIDER = 1.1  # than the domain, points are drawn from
_TESTS = Path(__file__).parent.parent / "tests"


def _pairs(smoke: bool) -> dict[str, PairPLR]:
    names = ("maze",) if smoke else ("maze", "arena")
    return {
        name: construct_pairs(workspace, max_bytes=PAIR_BYTES[name])
        for name, (workspace, _) in load_maps(names).items()
    }


def _cones(max_bytes: int = CONE_BYTES) -> PLR:
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    cones = construct(oracle, problem.workspace.bounds, leaf="cone", max_bytes=max_bytes, certified=True)
    return cones.with_label("maze")


# Answers in Node that differ from those of NumPy by a bit, of points in and around the domain, of 64 bits.


def bits(seed: int, smoke: bool) -> dict[str, Any]:
    count, rows = 2_000 if smoke else NUM_POINTS, []
    around = Box((-0.3, 1), (3, 1.7), periodic=(False, True))
    twice = Box((0, -1), (2, 1), periodic=(True, True))
    more = {
        "around, planes": lambda: construct(_waves, around, max_leaves=200),
        "around twice, continuous": lambda: construct(_waves, twice, leaf="continuous", max_leaves=200),
        "around, smooth": lambda: construct(_waves, around, leaf="smooth", max_leaves=100),
    }
    with tempfile.TemporaryDirectory() as folder:
        for name, make in {**portable.plrs(512 if smoke else 2048), **more}.items():
            plr, rng = make(), np.random.default_rng(seed)
            module = NodeModule(plr.js_module(), Path(folder))
            center, half = (plr.domain.lo + plr.domain.hi) / 2, _WIDER / 2 * plr.domain.width
            x = center + half * rng.uniform(-1, 1, (count, plr.dim))
            row = {"what": name, "leaf": plr.leaf.name, "text": len(plr.js_module()), "file": plr.num_bytes}
            row["different"] = _different(module(x)[:, 0], plr.numpy()(x))
            row["nanoseconds"] = module.nanoseconds(x[:CHUNK])
            rows.append(row)
            print(rows[-1], flush=True)
        for name, pairs in _pairs(smoke).items():
            text = f"{pairs.js_module()}\nexport const ofRow = z => distance(z.subarray(0, 2), z.subarray(2));\n"
            module, f, rng = NodeModule(text, Path(folder)), pairs.numpy(), np.random.default_rng(seed)
            center, half = (
                np.tile((pairs.domain.lo + pairs.domain.hi) / 2, 2),
                _WIDER / 2 * np.tile(pairs.domain.width, 2),
            )
            x = center + half * rng.uniform(-1, 1, (count, 4))
            different = _different(module(x, "ofRow")[:, 0], f(x[:, :2], x[:, 2:]))
            seconds = module.seconds[0]
            rows.append({"what": f"{name}, pairs", "leaf": "pairs", "text": len(text), "file": pairs.num_bytes})
            rows[-1] |= {"different": different, "nanoseconds": seconds / count * 1e9}
            print(rows[-1], flush=True)
    return {"points": count, "rows": rows}


def _waves(x: np.ndarray) -> np.ndarray:
    return 3 + np.sin(np.pi * x[:, 0]) + np.cos(20 / 7 * np.pi * x[:, -1])


def _different(found: np.ndarray, expected: np.ndarray) -> int:
    wide = expected.astype(np.float64)
    same = (found == wide) & (np.signbit(found) == np.signbit(wide)) | np.isnan(found) & np.isnan(wide)
    return int(np.count_nonzero(~same))


# Pages in a browser.


def pages(seed: int, smoke: bool) -> dict[str, Any]:
    problem, cones = scenes.maze(), _cones()
    shown = {"maze, cones": plot.page(cones, problem.workspace)}
    shown["maze, planes"] = plot.page(portable.plrs(2048)["maze, planes"](), problem.workspace)
    shown |= {f"{name}, pairs": plot.page(pairs) for name, pairs in _pairs(smoke).items()}
    rows = []
    with tempfile.TemporaryDirectory() as folder, Browser() as browser:
        for name, page in shown.items():
            page.save(path := Path(folder) / "page.html")
            browser.open(path, IS_DRAWN)
            row = {"what": name, "bytes": len(page.html.encode()), "requests": len(browser.requests) - 1}
            row |= {"errors": len(browser.errors), "queries_a_second": _rate(browser, smoke)}
            row["redraw_milliseconds"] = median(
                browser.milliseconds(_REDRAW.format(k=k)) for k in range(5 if smoke else 41)
            )
            row["violations"] = _violations(browser)
            rows.append(row)
            print(row, flush=True)
    return {"rows": rows}


_REDRAW = """
    goal = [between(view.lo[0], view.hi[0], 0.1 + 0.02 * {k}), between(view.lo[1], view.hi[1], 0.5)];
    drawField();
"""
_MANY = """
globalThis.points = Float64Array.from({ length: 4 << 18 }, (_, i) => {
    const axis = i % 2;
    return between(view.lo[axis], view.hi[axis], (i >> 1) * (axis ? 0.7548776662 : 0.6180339887) % 1);
});
globalThis.many = () => {
    const { distance } = shown(), x = [0, 0], y = [0, 0];
    let sum = 0;
    for (let i = 0; i < points.length; i += 2) { x[0] = points[i]; x[1] = points[i + 1]; sum += distance(x); }
    return sum;
};
globalThis.manyPairs = () => {
    const { distance } = shown();
    let sum = 0;
    const at = i => points.subarray(i, i + 2);
    for (let i = 0; i < points.length; i += 64) sum += distance(at(i), at(i + 2));
    return sum;
};
many.count = points.length / 2;
manyPairs.count = points.length / 64;
0
"""


def _rate(browser: Browser, smoke: bool) -> float:
    """Queries a second of one thread: the median of several runs, after one that compiles."""
    browser.run(_MANY)
    many = "manyPairs" if browser.run("Boolean(opened.isOfPairs)") else "many"
    times = [browser.milliseconds(f"{many}()") for _ in range(3 if smoke else 16)]
    return browser.run(f"{many}.count") / median(times[1:]) * 1e3


def _violations(browser: Browser) -> list[str] | None:
    """What axe-core objects to; None where there is none."""
    if (axe := axe_core()) is None:
        return None
    found: set[str] = set()
    for theme in ("light", "dark"):
        browser.prefer(prefers_color_scheme=theme)
        browser.run(f"{axe}; 0")
        found |= set(browser.run("axe.run().then(results => results.violations.map(each => each.id))"))
    return sorted(found)


# Damaged files, dropped on a page: half of what is mutated is cones, a quarter pairs. Checksums are made right again.


def hostile(seed: int, smoke: bool) -> dict[str, Any]:
    sys.path.append(str(_TESTS))
    hostile_files, readers = import_module("hostile_files"), import_module("hostile_readers")
    pairs = _pairs(smoke=True)["maze"]
    valid = [_cones(400).to_bytes(), _cones(200).to_bytes(), pairs.to_bytes()]
    valid.append(construct(_waves, ((0, 0), (2, 2)), max_leaves=30).to_bytes())
    reader = readers.Reader(lambda path: None, ".plr", lambda: valid, readers.READERS["PLR"].repaired)
    shown, said, seconds, failed = 0, set(), [], 0
    with tempfile.TemporaryDirectory() as folder, Browser() as browser:
        plot.page(_cones(400), scenes.maze().workspace).save(path := Path(folder) / "page.html")
        browser.open(path, IS_OPEN)
        for number in range(20 if smoke else NUM_FILES):
            data = b64encode(hostile_files.hostile(reader, valid, seed, number)).decode()
            is_shown, says, took = browser.run(
                f'(() => {{ const given = bytesOf("{data}"), began = performance.now(); take(given, "it"); return '
                "[byId('error').hidden, byId('error').textContent, (performance.now() - began) / 1e3]; })()"
            )
            is_told = bool(re.fullmatch(r"it cannot be shown: .{10,}\.", says)) and "Error" not in says
            failed += not (is_shown or (is_told and "undefined" not in says))
            shown += is_shown
            said.add(re.sub(r"[\d.e+-]+|: .*", "#", says.partition(": ")[2]))
            seconds.append(took)
        errors = len(browser.errors)
    return {
        "files": len(seconds),
        "shown": shown,
        "refused": len(seconds) - shown - failed,
        "failed": failed + errors,
        "messages": len(said),
        "median_seconds": float(np.median(seconds)),
        "most_seconds": max(seconds),
    }


SECTIONS = {"bits": Section(bits), "pages": Section(pages), "hostile": Section(hostile)}

if __name__ == "__main__":
    run("page", __doc__, SECTIONS)
