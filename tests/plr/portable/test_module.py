"""Modules of JavaScript answer as ``plr.numpy()`` does, to the bit, and need nothing else."""

import re
import shutil

import numpy as np
import pytest
from portable_helpers import CASES, case, hard_points, same_bits
from vectors import read_vector, vector_names

from experiments._js_modules import NodeModule
from plr_jax import load
from plr_jax.plr.portable.javascript import JavaScriptWriter, js_cone_reader, js_file_reader, single


@pytest.fixture(scope="module", autouse=True)
def _node():
    if shutil.which("node") is None:
        pytest.skip("modules are run where there is Node, as node")


@pytest.mark.full
@pytest.mark.parametrize("name", CASES)
def test_answers_are_those_of_numpy(name, tmp_path):
    plr = case(name)
    in_node, f, x = NodeModule(plr.js_module(), tmp_path), plr.numpy(), hard_points(plr, 5_000).astype(np.float64)
    x = np.concatenate([x, x[: len(x) // 2] * (1 + 1e-9)])  # of 64 bits
    found = in_node(x)[:, 0]
    assert same_bits(found.astype(np.float32), f(x)) and same_bits(found, f(x).astype(np.float64))
    if plr.leaf.name == "cone":
        waypoints = f.waypoint(x)
        assert same_bits(in_node(x, "waypoint", plr.dim), waypoints.astype(np.float64))
    if f.max_error is not None:
        assert same_bits(in_node(x, "bounds", 2), np.stack(f.bounds(x), axis=1).astype(np.float64))


@pytest.mark.full
@pytest.mark.parametrize("name", vector_names())
def test_vectors_are_answered_bit_for_bit(name, tmp_path):
    path, x, expected, _ = read_vector(name)
    found = NodeModule(load(path).js_module(), tmp_path)(x.astype(np.float64))[:, 0].astype(np.float32)
    # Around the seam, a point of 32 bits is not wrapped in 64 before.
    with np.errstate(invalid="ignore"):
        differs = ~((found == expected) | (np.isnan(found) & np.isnan(expected)))
    periodic = np.array(load(path).domain.periodic)
    assert not differs.any() or (periodic.any() and differs.mean() < 0.1)
    assert same_bits(found, load(path).numpy()(x.astype(np.float64)))


@pytest.mark.full
@pytest.mark.parametrize("name", ["maze of cones", "far cones"])
def test_files_of_cones_are_read_and_answered(name, tmp_path):
    """By a program that is of no file, from the bytes of one."""
    plr = case(name)
    text = "\n".join([js_file_reader(), js_cone_reader()])
    file = f"Uint8Array.from({list(plr.to_bytes())})"
    opened = f"(file => coneReader(readCones(file, file.layers[0])))(readContainer({file}))"
    in_node = NodeModule(f"{text}\nexport const {{ distance, waypoint, bounds }} = {opened};", tmp_path)
    x, f = hard_points(plr, 2_000).astype(np.float64), plr.numpy()
    assert same_bits(in_node(x)[:, 0], f(x).astype(np.float64))
    assert same_bits(in_node(x, "waypoint", 2), f.waypoint(x).astype(np.float64))
    if f.max_error is not None:
        assert same_bits(in_node(x, "bounds", 2), np.stack(f.bounds(x), axis=1).astype(np.float64))


def test_it_imports_and_exports_what_it_says():
    for name, exported in (("maze of cones", {"distance", "waypoint", "bounds"}), ("folded car", {"distance"})):
        text = case(name).js_module()
        assert set(re.findall(r"^export function (\w+)", text, re.MULTILINE)) == exported
        assert not re.search(r"\bimport\b|\brequire\b|https?:", text)


def test_decimals_are_read_as_the_same_number():
    rng = np.random.default_rng(0)
    numbers = rng.integers(0, 2**31, 20_000, dtype=np.uint32).view(np.float32)
    numbers = np.append(numbers[~np.isnan(numbers)], np.array([0.1, -0.0, np.inf], np.float32))
    for number in numbers:
        read = np.float32(float(single(number).replace("Infinity", "inf")))
        assert same_bits(read, number) and len(single(number)) < 24


@pytest.mark.parametrize(
    ("build", "text"),
    [
        (lambda x, y, z: x + y + z, "f(f(x + y) + z)"),
        (lambda x, y, z: x - (y - z) * x, "f(x - f(f(y - z) * x))"),
        (lambda x, y, z: -(x + y) * z, "f(-f(x + y) * z)"),
        (lambda x, y, z: x - np.float32(0.1), "f(x - 0.10000000149011612)"),
        (lambda x, y, z: x * np.float64(0.1), "x * 0.1"),
        (lambda x, y, z: (x < y) & (z >= np.float32(np.inf)), "x < y && z >= Infinity"),
    ],
)
def test_each_operation_is_rounded(build, text):
    do = JavaScriptWriter()
    assert str(build(*(do.atom(name) for name in "xyz"))) == text
