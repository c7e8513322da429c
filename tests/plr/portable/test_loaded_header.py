"""Headers of C that load their tables: they answer as headers that hold them, and refuse what is none of theirs."""

import ctypes
import shutil
import subprocess
import zlib

import numpy as np
import pytest
from portable_helpers import case, hard_points, is_far, same_bits

from experiments._c_headers import STRICT, CompiledHeader
from plr_jax import Euclidean, construct

LOAD = "int load(const void *data, uint32_t size);\n" + (
    "int load(const void *data, uint32_t size) { return here_load(data, size); }\n"
)


class Loading(CompiledHeader):
    """A header that loads its tables, compiled."""

    def __init__(self, plr, folder):
        text = plr.c_header("here", loads_tables=True) + LOAD
        super().__init__(text, "here", np.float64 if is_far(plr) else np.float32, plr.dim, folder)

    def load(self, data):
        """Whether it takes these bytes."""
        held = ctypes.create_string_buffer(data, len(data) + 1)
        if taken := self.library.load(held, len(data)):
            self.held = held
        return taken


@pytest.fixture(autouse=True)
def compiler():
    if shutil.which("cc") is None:
        pytest.skip("headers are compiled where there is a C compiler called cc")


@pytest.mark.parametrize("name", ["maze of planes", "maze of gradients", "cones in space", "one leaf", "far car"])
def test_answers_are_those_of_numpy(name, tmp_path):
    plr = case(name)
    in_c, f, x = Loading(plr, tmp_path), plr.numpy(), hard_points(plr, 5_000)
    assert np.isnan(in_c(x)[~np.isinf(f(x))]).all()
    assert in_c.load(plr.c_tables()) == 1
    assert same_bits(in_c(x), f(x))
    if plr.leaf.name == "cone":
        assert same_bits(in_c.waypoints(x), f.waypoint(x))
    if (plus := shutil.which("c++")) is not None:
        (tmp_path / "a.hpp").write_text(plr.c_header("a", loads_tables=True))
        subprocess.run([plus, *STRICT, "-fsyntax-only", "-x", "c++", tmp_path / "a.hpp"], check=True)


def test_tables_are_exchanged_without_compiling_again(tmp_path):
    """Also for those of one leaf, and back."""
    plrs = [
        construct(lambda x, y=y: np.sin(x[:, 0] + y) + x[:, 1], ((-1, -1), (3, 2)), leaf="plane", max_leaves=most)
        for y, most in ((0, 30), (1, 1), (2, 200))
    ]
    texts = {plr.c_header("here", loads_tables=True) for plr in plrs}
    assert len(texts) == 1
    in_c = Loading(plrs[0], tmp_path)
    for plr in [*plrs, plrs[0]]:
        x = hard_points(plr, 2_000)
        assert in_c.load(plr.c_tables()) == 1
        assert same_bits(in_c(x), plr.numpy()(x))


def test_what_is_refused_changes_nothing(tmp_path):
    plr, other = case("maze of planes"), construct(Euclidean((1, 2)), ((0, 0), (1, 1.5)), max_leaves=20)
    in_c, good, x = Loading(plr, tmp_path), plr.c_tables(), hard_points(plr, 1_000)
    assert in_c.load(good)
    answers, words = in_c(x), np.frombuffer(good, "<u4")
    wrong = [b"", good[:20], good[:-4], good + bytes(4), other.c_tables(), case("cones in space").c_tables()]
    rng = np.random.default_rng(0)
    for byte in rng.integers(len(good), size=200):
        wrong.append(good[:byte] + bytes([good[byte] ^ 1 << rng.integers(8)]) + good[byte + 1 :])
    for place, code in [(4, words[2] << 2), (4, 3), (5, 0), (5, 3), (5, words[3] << 2 | 2), (6, words[2] << 2)]:
        changed = words.copy()  # crafted, with a checksum that is right
        changed[place] = code
        changed[-1] = zlib.crc32(changed[:-1].tobytes())
        wrong.append(changed.tobytes())
    for data in wrong:
        assert in_c.load(data) == 0, data
    assert same_bits(in_c(x), answers)
    shifted = ctypes.create_string_buffer(bytes(1) + good)
    assert in_c.library.load(ctypes.byref(shifted, 1), len(good)) == 0
