"""The sizes of lookup tables, which depend on the size of a PLR's file.

Two grids locate a point's leaf. A *block* is a cell of a coarse grid with ``2**block_bits`` cells along each axis. In
each block, a finer grid separates the leaves. A *slot* is a cell of a finer grid, and has one entry in a lookup
table.
"""

_MIN_CLASS = 8  # smallest size class of a file, 256 bytes
_SLOT_BITS = ((2**10, 14), (2**12, 16))  # (most leaves, log2 of slots); _MAX_FLAT_BITS for more leaves
MOST_ROWS = 2**14  # most leaves of a size class whose tables all have one shape
_MAX_FLAT_BITS = 18  # a flat table of 16-bit entries then fits a core's second-level cache
_DEEP_BITS = 28  # most halvings, summed over the axes, for more leaves than MOST_ROWS or more than two axes
_PAGED_DEPTH = 14  # most halvings along an axis of tables with pages, so that blocks and pages stay small
# Limit of entries of lookup tables: 2**9 for each byte of the file's size class, from 2**20 to 2**27.
_MAX_BITS_BEYOND_CLASS = 9
_LEAST_ENTRIES_BITS = 20
_MOST_ENTRIES_BITS = 27


def byte_class(num_bytes: int) -> int:
    """Return the size class of a file of ``num_bytes`` bytes: the logarithm to base 2, rounded up, at least 8."""
    return max(_MIN_CLASS, (num_bytes - 1).bit_length())


def rows_of_class(of_class: int, least_bytes: int | float) -> int:
    """Return how many leaves of ``least_bytes`` bytes each fit into a file of ``2**of_class`` bytes."""
    return int((1 << of_class) / least_bytes)


def slot_bits_of_rows(rows: int) -> int:
    """Return the logarithm to base 2 of the least size of a lookup table for a file with room for ``rows`` leaves.

    The size is a number of entries. Smaller tables are padded to this size, so that files with equally much room
    mostly have tables of one shape and share compiled code.
    """
    return next((bits for most, bits in _SLOT_BITS if rows <= most), _MAX_FLAT_BITS)


def max_axis_depth(dim: int, of_class: int | None, least_bytes: int | float, is_deep: bool) -> int:
    """Return how often cells may be halved along one axis in a file of ``2**of_class`` bytes (None: any size).

    Each leaf takes at least ``least_bytes`` bytes. ``is_deep`` allows more halvings in small files in up to two
    dimensions.
    """
    rows = None if of_class is None else rows_of_class(of_class, least_bytes)
    if rows is None or rows > MOST_ROWS or dim > 2:
        return max(1, min(_MAX_FLAT_BITS, _DEEP_BITS // dim))
    return max(slot_bits_of_rows(rows) // dim, _PAGED_DEPTH if is_deep else 0)


def max_entries(num_bytes: int) -> int:
    """Return the most entries of lookup tables for a file of ``num_bytes`` bytes, to limit memory during loading."""
    return 1 << min(max(byte_class(num_bytes) + _MAX_BITS_BEYOND_CLASS, _LEAST_ENTRIES_BITS), _MOST_ENTRIES_BITS)
