import pytest

from plr_jax.plr.query.sizes import byte_class, max_axis_depth, max_entries, rows_of_class, slot_bits_of_class


@pytest.mark.parametrize(
    ("num_bytes", "expected"), [(1, 8), (256, 8), (257, 9), (2048, 11), (2049, 12), (4096, 12), (10**6, 20)]
)
def test_a_class_is_the_power_of_two_that_holds_the_bytes(num_bytes, expected):
    assert byte_class(num_bytes) == expected


def test_tables_have_room_for_as_many_leaves_as_a_file_can_hold():
    assert rows_of_class(11, 2) == 1024
    assert rows_of_class(11, 1) == 2048


@pytest.mark.parametrize(
    ("of_class", "expected"), [(8, 14), (11, 14), (12, 16), (13, 16), (14, 18), (15, 18), (16, 18), (30, 18)]
)
def test_slots_grow_with_the_class(of_class, expected):
    assert slot_bits_of_class(of_class, 0) == expected
    assert slot_bits_of_class(of_class, expected) == expected
    assert slot_bits_of_class(of_class, 20) == 20


@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("of_class", range(8, 16))
def test_on_a_line_and_in_the_plane_the_cells_of_a_class_fit_its_table(dim, of_class):
    assert dim * max_axis_depth(dim, of_class) <= slot_bits_of_class(of_class, 0)


@pytest.mark.parametrize("dim", [1, 2, 3, 5, 8, 28, 50])
def test_more_bytes_never_mean_larger_cells(dim):
    depths = [max_axis_depth(dim, of_class) for of_class in (*range(8, 30), None)]
    assert depths == sorted(depths) and depths[0] >= 1 and depths[-1] <= 18


def test_what_a_reader_allocates_grows_with_the_file_up_to_an_end():
    entries = [max_entries(1 << bits) for bits in range(8, 40)]
    assert entries == sorted(entries)
    assert entries[0] == 2**20 and entries[-1] == 2**27
    assert max_entries(2**13) == 2**22
