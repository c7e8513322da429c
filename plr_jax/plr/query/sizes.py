"""How large a query's tables are: as the byte class of the file says, so that PLRs of one class share compiled code.

The class of a file is the exponent of the power of two that holds its bytes. It fixes how many leaves the tables have
room for and, in the plane and on a line, how many slots; what is left of them is padding, which is never read.
"""

MIN_CLASS = 8
_SLOT_BITS = ((11, 14), (13, 16), (15, 18))  # up to a class, bits of a flat table
MAX_FLAT_BITS = 18  # a flat table of 16-bit leaves then fits a core's second-level cache
_DEEP_BITS = 28  # of a point's place in all, beyond the classes above
_MAX_BITS_BEYOND_CLASS, _LEAST_ENTRIES_BITS, _MOST_ENTRIES_BITS = 9, 20, 27


def byte_class(num_bytes: int) -> int:
    """The smallest exponent of a power of two that is at least so many bytes."""
    return max(MIN_CLASS, (num_bytes - 1).bit_length())


def rows_of_class(of_class: int, least_bytes: int) -> int:
    """Leaves for which the tables of a class have room, where a leaf takes so many bytes at the least."""
    return (1 << of_class) // least_bytes


def slot_bits_of_class(of_class: int, needed: int) -> int:
    """Bits of a class's flat table; as many as are needed, where that is more."""
    return max(needed, next((bits for last, bits in _SLOT_BITS if of_class <= last), MAX_FLAT_BITS))


def max_axis_depth(dim: int, of_class: int | None) -> int:
    """How often a cell may be halved along one axis, for a class of files or for any.

    In the plane and on a line the tables of a class then have one shape; elsewhere their size is bounded.
    """
    if of_class is None or of_class > _SLOT_BITS[-1][0] or dim > 2:
        return max(1, min(MAX_FLAT_BITS, _DEEP_BITS // dim))
    return slot_bits_of_class(of_class, 0) // dim


def max_entries(num_bytes: int) -> int:
    """Entries that the tables of a file of so many bytes may have: they bound what loading it takes."""
    bits = byte_class(num_bytes) + _MAX_BITS_BEYOND_CLASS
    return 1 << min(max(bits, _LEAST_ENTRIES_BITS), _MOST_ENTRIES_BITS)
