"""A header of C99 whose tables are loaded when the program runs, and what it loads.

The tables of a PLR, as little-endian words of 32 bits:

    magic, 0x314C5250
    CRC-32 of the text of the functions, which is the same for all PLRs of a domain and a leaf model
    number of cells that are split, number of different rows of leaves' numbers, code of the tree's root
    codes of both halves of every split cell, then rows of numbers, floats: as in a header that holds them
    CRC-32 of all words before
"""

import struct
import zlib
from functools import cached_property

from plr_jax.plr.portable.header import CHeader
from plr_jax.plr.portable.program import Program

_MAGIC, _HEAD_WORDS, _ANY = 0x314C5250, 5, "plr"


class LoadedHeader(CHeader):
    """The parts of a header that loads its tables."""

    @property
    def has_tree(self) -> bool:
        """Tables that are loaded later may have one."""
        return True

    @property
    def root(self) -> str:
        """That of the tables that were loaded last."""
        return f"{self.name}_root"

    def leaves(self) -> str:
        """None but those that are loaded."""
        return "leaves"

    def about_tables(self) -> list[str]:
        """How they are loaded."""
        name = self.name
        return [
            f"   {name}_load: takes the tables in a file that was written for this header, of any PLR of this",
            "   domain and kind of leaves. Returns 1, or 0 if it is no such file, or damaged: nothing has changed.",
            "   The bytes begin at a multiple of 4, and stay where they are until others are loaded, while no",
            "   query runs. Source files that include this header load their own; before, answers are NAN.",
        ]

    @cached_property
    def fingerprint(self) -> int:
        """Of the functions, whatever their name."""
        header = self if self.name == _ANY else LoadedHeader(self.program, _ANY)
        return zlib.crc32("\n".join(header.functions()).encode())

    def tables(self) -> list[str]:
        """None yet, and what loads them."""
        name, count, kinds = self.name, self.rows.shape[1], (1 << self.tree.kind_bits) - 1
        dim, bits = self.program.dim, self.tree.kind_bits
        return [
            f"static const float {name}_nothing[1][{count}] = {{{{{', '.join(['NAN'] * count)}}}}};",
            f"static const float (*{name}_numbers)[{count}] = {name}_nothing;",
            f"static const uint32_t (*{name}_tree)[2] = 0;",
            f"static uint32_t {name}_root = {dim};",
            "",
            "/* Whether a code in the tables is a leaf's, or of a cell that is split behind a given one. */",
            f"static inline int {name}_is_code(uint32_t code, uint32_t first, const uint32_t counts[2])",
            "{",
            f"    const uint32_t kind = code & {kinds}u, index = code >> {bits};",
            f"    return kind < {dim}u ? first <= index && index < counts[0] : kind == {dim}u && index < counts[1];",
            "}",
            "",
            f"static inline int {name}_load(const void *data, uint32_t size)",
            "{",
            "    const uint32_t *const words = (const uint32_t *)data;",
            "    const unsigned char *const bytes = (const unsigned char *)data;",
            "    uint32_t crc = 0xFFFFFFFFu, i;",
            f"    if ((uintptr_t)data % 4 != 0 || size % 4 != 0 || size / 4 < {_HEAD_WORDS + 1}u) {{",
            "        return 0;",
            "    }",
            f"    if (words[0] != 0x{_MAGIC:X}u || words[1] != 0x{self.fingerprint:X}u",
            f"        || size / 4 != {_HEAD_WORDS + 1} + 2 * (uint64_t)words[2] + {count} * (uint64_t)words[3]) {{",
            "        return 0;",
            "    }",
            "    for (i = 0; i < size - 4; ++i) {",
            "        int bit;",
            "        crc ^= bytes[i];",
            "        for (bit = 0; bit < 8; ++bit) {",
            "            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));",
            "        }",
            "    }",
            f"    if (words[size / 4 - 1] != ~crc || !{name}_is_code(words[4], 0, words + 2)) {{",
            "        return 0;",
            "    }",
            "    for (i = 0; i < 2 * words[2]; ++i) {",
            f"        if (!{name}_is_code(words[{_HEAD_WORDS} + i], i / 2 + 1, words + 2)) {{",
            "            return 0;",
            "        }",
            "    }",
            f"    {name}_tree = (const uint32_t (*)[2])(const void *)(words + {_HEAD_WORDS});",
            f"    {name}_numbers = (const float (*)[{count}])(const void *)(words + {_HEAD_WORDS} + 2 * words[2]);",
            f"    {name}_root = words[4];",
            "    return 1;",
            "}",
            "",
        ]

    def loaded_tables(self) -> bytes:
        """The tables of this PLR."""
        num_splits, num_rows = len(self.tree.children), len(self.rows)
        words = struct.pack("<5I", _MAGIC, self.fingerprint, num_splits, num_rows, self.tree.root)
        words += self.tree.children.astype("<u4").tobytes() + self.rows.astype("<f4").tobytes()
        return words + struct.pack("<I", zlib.crc32(words))


def c_tables(program: Program) -> bytes:
    """What a header of a PLR that loads its tables loads of this one."""
    return LoadedHeader(program, _ANY).loaded_tables()
