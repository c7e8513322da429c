"""Deltas make the new file byte for byte, of that old file alone; they are small, and damaged ones are refused."""

import os
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import random_partition
from portable_helpers import case
from vectors import FOLDER

from plr_jax import VisibilityGraph, Workspace, construct, from_bytes, load_numpy, progressive
from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.plr._file import Contents, encode
from plr_jax.plr.certificate.bounds import LeafBounds
from plr_jax.plr.certificate.certificate import Certificate, Proof
from plr_jax.plr.delta.file_delta import delta_of_files, patched_file
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import as_sourced
from plr_jax.plr.partition.cells import levels_of

BOUNDS, GOAL, BYTES = ((0, 0), (8, 6)), (1.0, 1.0), 1200
WALLS = [shapely.box(2.5, 0, 3, 4), shapely.box(5, 2, 5.5, 6), shapely.box(6, 1, 7, 1.5)]
HEAD = 11  # bytes of magic, version and digests


@pytest.fixture(scope="module")
def living():
    """Cones of a map in which boxes are set down, one after another, then taken away."""
    oracle = VisibilityGraph(Workspace(BOUNDS, WALLS), GOAL)
    plrs = [construct(oracle, BOUNDS, leaf="cone", max_bytes=BYTES, certified=True).with_label("hall")]
    rng, changes = np.random.default_rng(0), []
    for _ in range(4):
        lo = rng.uniform((0, 2), (7, 5))
        changes.append({"add": [shapely.box(*lo, *(lo + rng.uniform(0.1, 0.5, 2)))]})
    for change in [*changes, {"remove": [3]}, {"remove": [5]}]:
        oracle = oracle.with_workspace(oracle.workspace.with_obstacles(**change))
        plrs.append(plrs[-1].updated(oracle))
    return plrs


def check(old, new):
    """That one is made of the other, and how large the delta is."""
    delta = delta_of_files(old, new)
    assert patched_file(old, delta) == new
    return len(delta)


def test_of_a_map_that_changes_few_bytes_are_sent(living):
    there = [check(old.to_bytes(), new.to_bytes()) for old, new in pairwise(living)]
    back = [check(new.to_bytes(), old.to_bytes()) for old, new in pairwise(living)]
    assert np.median(there) < BYTES / 2 and np.median(back) < BYTES / 2
    assert max(there + back) < BYTES


def test_a_plr_and_its_numpy_twin_are_patched_alike(living):
    old, new = living[:2]
    delta, x = new.delta(old), np.random.default_rng(0).uniform((0, 0), (8, 6), (100, 2))
    assert delta == new.delta(old.numpy()) == delta_of_files(old.to_bytes(), new.to_bytes())
    patched, twin = old.patched(delta), old.numpy().patched(delta)
    assert patched.to_bytes() == twin.to_bytes() == new.to_bytes() and patched.label == "hall"
    np.testing.assert_array_equal(patched(x), new(x))
    np.testing.assert_array_equal(twin(x), new.numpy()(x))
    np.testing.assert_array_equal(patched.bounds(x), new.bounds(x))
    with pytest.raises(ValueError, match="from another PLR, got 3"):
        new.delta(3)


def test_what_has_not_changed_takes_few_bytes(living):
    plr = living[0]
    assert check(plr.to_bytes(), plr.to_bytes()) < HEAD + 8
    assert check(plr.to_bytes(), plr.with_label("Übung").to_bytes()) < HEAD + 16
    assert check(plr.with_label("hall " * 200).to_bytes(), plr.with_label("").to_bytes()) < HEAD + 16


def test_the_base_is_named(living):
    old, new, other = living[:3]
    delta = new.delta(old)
    for wrong in (other, new, old.with_label("hall 2")):
        with pytest.raises(ValueError, match="of another file than this one; make it of this one"):
            wrong.patched(delta)


@pytest.mark.parametrize("name", ["maze of planes", "maze of gradients", "maze of cones", "cones in space", "car"])
def test_of_any_two_plrs(name, living):
    """Of other leaves, domains and dimensions the whole file is sent."""
    plr = case(name).to_bytes()
    for other in (case("maze of values").to_bytes(), case("one leaf").to_bytes(), living[0].to_bytes()):
        assert check(other, plr) < len(plr) + 40
        assert check(plr, other) < len(other) + 40


def test_of_several_layers(living):
    small = construct(lambda x: np.hypot(*x.T), BOUNDS, leaf="plane", max_leaves=8)
    both = progressive([small, living[0]]).to_bytes()
    check(living[0].to_bytes(), both)
    assert check(both, living[0].to_bytes()) < HEAD + 16


def random_cones(seed, dim, proof, domain):
    """A file of random cones: a random partition, sources on a lattice or not, parents and bounds."""
    rng = np.random.default_rng(seed)
    cells, count = random_partition(seed, dim, int(rng.integers(0, 40))), int(rng.integers(1, 9))
    points = np.where(
        rng.random((count, 1)) < 0.5, rng.integers(-3, 9, (count, dim)) / 4, rng.normal(size=(count, dim))
    )
    parents = np.array([int(rng.integers(0, i + 1)) for i in range(count)])  # never in a circle
    model, source = as_sourced(leaf_model("cone")), rng.integers(-1, count, len(cells))
    source[0] = 0
    cells, stored = model.of_sources(domain, cells, source, Sources(points, rng.random(count), parents))
    certificate = None
    if proof is not Proof.NONE:
        upper = rng.choice([0.1, 0.3, np.inf if proof is Proof.OPEN_LEAVES else 1], len(cells))
        bounds = LeafBounds(-rng.choice([0.1, 0.2], len(cells)), upper)
        certificate = Certificate.of(bounds, np.zeros(len(cells)), proof, num_bytes=10_000)
    return encode(Contents(domain, model, levels_of(cells)[0], cells, stored, certificate))


@settings(max_examples=60, deadline=None)
@given(
    seeds=st.tuples(st.integers(0, 50), st.integers(0, 50)),
    dim=st.integers(1, 3),
    proofs=st.tuples(*[st.sampled_from(Proof)] * 2),
)
def test_of_any_two_files_of_cones(seeds, dim, proofs):
    domain = Box([-1.25] * dim, [2.5] * dim)
    check(*(random_cones(seed, dim, proof, domain) for seed, proof in zip(seeds, proofs, strict=True)))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", ["flipped", "cut", "random", "longer"])
def test_damaged_deltas_are_refused(kind, living):
    """Behind the digests, as what is wrong there is told at once."""
    old, new = living[1].to_bytes(), living[2].to_bytes()
    rng, good = np.random.default_rng(0), delta_of_files(old, new)
    for _ in range(150):
        at = int(rng.integers(HEAD, len(good)))
        damaged = {
            "flipped": good[:at] + bytes([good[at] ^ 1 << rng.integers(8)]) + good[at + 1 :],
            "cut": good[:at],
            "random": good[: HEAD + 2] + rng.bytes(int(rng.choice([1, 30, 3000]))),
            "longer": good[:at] + rng.bytes(3) + good[at:],
        }[kind]
        try:
            assert patched_file(old, damaged) == new
        except ValueError as error:
            assert str(error).startswith("The delta cannot be used: ")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda delta: b"", "does not start like one"),
        (lambda delta: b"PLR" + delta, "does not start like one"),
        (lambda delta: delta[:2] + b"\x02" + delta[3:], "version 2, this release reads version 1; update plr_jax"),
        (lambda delta: delta[:9], "data end too early"),
        (lambda delta: delta[:HEAD] + b"\xff\xff\x7f" + delta[HEAD + 1 :], "states 2,097,151 leaves"),
        (lambda delta: delta[:2] + b"\x11" + delta[3:], "it is damaged"),
        (lambda delta: delta[:2] + b"\x11" + delta[3:HEAD] + b"\xff" * 5 + b"\0", "more than 268,435,456 bytes"),
        (lambda delta: "delta", "A delta is bytes"),
    ],
)
def test_what_is_no_delta_is_refused(change, message, living):
    old, new = living[:2]
    with pytest.raises(ValueError, match=message):
        old.patched(change(new.delta(old)))


KEPT = (
    "50d50143605f7355c3480bcc03f3d98d82a1aaf3126931e872f0aeaa34f5cad884a13d4985b933059b560a645b49544eb788"
    "ff69796b492f151756c2aeba2f02986f1a737f87821cf854ceefbc3e0ee69ba89cbbff8a7a812befbda0d9f13e75733efc36"
    "c7641bf5f841dc201372af55d8dcbf4db222caa49e146877b9964dfc0c8152650d6444141984c747ec"
)


def test_deltas_that_were_written_before_are_still_read():
    """Into a file that has the digest in the delta, or it would be refused."""
    old = load_numpy(FOLDER / "maze_of_cones.plr")
    new = from_bytes(old.patched(bytes.fromhex(KEPT)).to_bytes())
    assert new.label == "box" and new.num_bytes == 336


def test_a_robot_without_jax_patches():
    code = f"""
import sys
import plr_jax
old = plr_jax.load_numpy({str(FOLDER / "maze_of_cones.plr")!r})
new = old.patched(bytes.fromhex({KEPT!r}))
print(len(new.to_bytes()), new((0.93, 0.95)))
sys.exit(len({{"jax", "scipy", "shapely"}} & set(sys.modules)))
"""
    command, environment = [sys.executable, "-c", code], dict(os.environ)
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.stdout.startswith("336 ") and done.returncode == 0, done.stderr
