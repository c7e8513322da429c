"""Bits, numbers, trees, domains and containers: written as by hand, read as written; all else raises."""

import decimal
import struct
import zlib

import jax
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from plr_helpers import assert_refused_for_little, sealed

import plr_jax
from plr_jax import ReedsShepp
from plr_jax._arrays import padded_size
from plr_jax.geometry.box import Box
from plr_jax.plr import container as container_module
from plr_jax.plr.coding import BitReader, BitWriter, ByteReader, bits_of_set, read_tree, signed_varint, varint
from plr_jax.plr.container import PAIRS_CODE, Container, Header, Layer, domain_to_bytes, frame_size, read_domain
from plr_jax.plr.folding import folding_of

# Bits, numbers, sets and trees.


FIELDS = st.lists(st.tuples(st.integers(0, 32), st.integers(0, 2**32 - 1)), max_size=20)


def bits_of(text):
    """Return the bytes of a stream of bits, the least significant first."""
    return np.packbits([int(bit) for bit in text.replace(" ", "")], bitorder="little").tobytes()


@given(
    rows=st.lists(FIELDS, min_size=1, max_size=4),
    unary=st.lists(st.integers(0, 40)),
    coded=st.lists(st.integers(0, 2**39)),
    member=st.lists(st.booleans()),
)
def test_bit_streams_are_read_as_written(rows, unary, coded, member):
    writer = BitWriter()
    rows = [np.array(row, np.int64).reshape(-1, 2).T for row in rows]
    rows = [(widths, values & ((1 << widths) - 1)) for widths, values in rows]
    for widths, values in rows:
        writer.write(values, widths)
    assert writer.num_bits == sum(int(widths.sum()) for widths, _ in rows)
    writer.write_unary(np.array(unary, np.int64)).write_coded(np.array(coded, np.int64))
    before = writer.num_bits
    writer.write_set(np.array(member, bool))
    assert writer.num_bits - before <= max(bits_of_set(sum(member), len(member)), 32)  # 0 stands for an unwritten set
    data = writer.write(np.array([1]), 1).to_bytes()
    assert len(data) == -(-writer.num_bits // 8)
    reader = BitReader(data)
    for widths, values in rows:
        np.testing.assert_array_equal(reader.read(widths), values)
    assert reader.read_unary(len(unary)).tolist() == unary
    assert reader.read_coded(len(coded)).tolist() == coded
    assert reader.read_set(len(member)).tolist() == member
    assert reader.read_fixed_width(1, 1)[0] == 1 and reader.at_end()


@pytest.mark.filterwarnings("error")
def test_any_32_bits_are_read_as_floats_without_warning():
    patterns = np.array([0x7FA00000, 0xFF800001, 0x7F800000, 1])  # two signaling NaNs, infinity, the least number
    body = BitWriter().write(patterns, 32).write_floats(np.array([0.1, -3.0]))
    read = BitReader(body.to_bytes()).read_floats(6)
    np.testing.assert_array_equal(read, [np.nan, np.nan, np.inf, 2.0**-149, np.float32(0.1), -3])


def number(value, bits):
    return BitWriter().write(np.array([value]), bits)


def code(order, extra):
    return number(order, 5).write_unary(np.array([extra])).write(np.zeros(order + extra, np.int64), 1)


def members(*gaps):
    return number(len(gaps), 32).write_coded(np.array(gaps))


@pytest.mark.parametrize(
    ("body", "read", "message"),
    [
        (number(255, 8), lambda body: body.read(np.array([5, 4])), "end too early"),
        (number(255, 8), lambda body: body.read_fixed_width(2**40, 1), "end too early"),
        (number(8, 8), lambda body: body.read_unary(2), "end too early"),
        (code(31, 100), lambda body: body.read_coded(1), "a number that is too large"),
        (code(0, 63), lambda body: body.read_coded(1), "a number that is too large"),
        (code(31, 31), lambda body: body.read_coded(1), "a number that is too large"),
        (code(0, 41), lambda body: body.read_coded(1), "a number that is too large"),
        (BitWriter().write_set(np.ones(5, bool)), lambda body: body.read_set(4), "it names 5 members of 4"),
        (number(2**32 - 1, 32), lambda body: body.read_set(10), "names 4294967295 members of 10"),
        (members(9), lambda body: body.read_set(9), "a member beyond the last of 9"),
        (members(3, 3), lambda body: body.read_set(5), "a member beyond the last of 5"),
        (members(2**39, 2**39), lambda body: body.read_set(5), "a member beyond the last of 5"),
    ],
)
def test_invalid_bit_streams_raise(body, read, message):
    reader = BitReader(body.to_bytes())
    assert not reader.at_end()
    with pytest.raises(ValueError, match=message):
        read(reader)


def test_writing_too_large_numbers_raises():
    with pytest.raises(ValueError, match="vary too much"):
        BitWriter().write_coded(np.array([2**40]))


@pytest.mark.parametrize(
    ("data", "dim", "message"),
    [
        (bits_of("1 11"), 3, "it splits axis 3 of 3"),
        (bits_of("1111"), 2, "end too early"),
        (b"\xff" * 100, 1, "end too early"),
        (bits_of("1" + "10" * 60 + "00"), 1, "its tree is deeper than 60"),
    ],
)
def test_invalid_trees_raise(data, dim, message):
    with pytest.raises(ValueError, match=message):
        read_tree(BitReader(data), dim)


# Domains and numbers of a header: read as written, bit for bit, in as few bytes as possible.


DOUBLES = st.floats(allow_nan=False, allow_infinity=False)
DECIMALS = st.builds(lambda digits, places: digits / 10**places, st.integers(-(10**7), 10**7), st.integers(0, 6))
ENDS = st.one_of(*(st.lists(each, min_size=2, max_size=2, unique=True).map(sorted) for each in (DOUBLES, DECIMALS)))


@given(st.lists(st.integers(0, 2**70 - 1)), st.lists(st.integers(-(2**69), 2**69 - 1)), st.binary(max_size=3))
def test_variable_length_integers_are_read_as_written(numbers, signed, rest):
    reader = ByteReader(b"".join([b"!", *map(varint, numbers), *map(signed_varint, signed), rest]))
    assert reader.byte() == ord("!")
    for number in numbers:
        before = reader.at
        assert reader.varint() == number
        assert reader.at - before == max(1, -(-number.bit_length() // 7))
    assert [reader.signed_varint() for _ in signed] == signed
    assert reader.take(len(rest)) == rest


@st.composite
def domains(draw):
    """Draw the arguments of a box: any numbers, many with few decimals, some axes periodic."""
    dim = draw(st.integers(1, 20))
    corners = np.array([draw(ENDS) for _ in range(dim)], np.float64)
    assume((corners[:, 0] < corners[:, 1]).all())
    return *corners.T, draw(st.lists(st.booleans(), min_size=dim, max_size=dim))


def read(data, dim, is_floats):
    reader = ByteReader(data)
    domain = read_domain(reader, dim, is_floats)
    assert reader.at == len(data)
    return domain


@given(domains(), st.sampled_from(["", "a", "Übersicht", 127 * "x", 64 * "ä"]))
def test_domains_are_read_as_written_and_never_longer_than_floats(box, label):
    """In the plane, header, domain and checksum have at most 40 bytes."""
    domain = Box(*box)
    data, is_floats = domain_to_bytes(domain)
    assert read(data, domain.dim, is_floats) == domain
    assert len(data) <= 16 * domain.dim
    most = 8 + (domain.dim > 15) + 16 * domain.dim
    assert frame_size(domain) <= most
    with_label = 2 + len(label.encode()) if label else 0  # the label's length, and that there is one layer
    assert frame_size(domain, label=label) <= most + with_label + (with_label >= 130)


@pytest.mark.parametrize(
    ("domain", "data"),
    [
        (Box((0, 0), (1, 1)), [0, 0, 0, 2, 2]),
        (Box((-1, 0), (1, 3)), [0, 1, 0, 2, 6]),
        (Box((0, 0), (49.5, 20.25)), [2, 0, 0, *signed_varint(4950), *signed_varint(2025)]),
        (Box((0.3, -0.1), (0.7, 0.0)), [1, 6, 1, 14, 0]),  # 0.1 + 0.2 is another number than 0.3
        (Box((-0.0,), (1e15,)), [0, 0, *signed_varint(10**15)]),
        (Box((-1e-22,), (1e-22,)), [22, 1, 2]),
        (Box((0,), (2.0**53 - 1,)), [0, 0, *signed_varint(2**53 - 1)]),  # in eight bytes
        (Box((0, -2), (10, 3), periodic=(False, True)), [0, 0, 6, 20, 3]),
        (Box((-np.pi,), (np.pi,)), None),  # 16 digits
        (Box((0,), (2.0**53 + 2,)), None),
        (Box((-1e-23,), (1e-23,)), None),
        (Box((0, 0), (1, 1e-30)), None),  # of few digits each, but of no common unit
        (Box((5e-324, -1e308), (1e-323, 1e308)), None),
        (Box((1 - 2.0**53,), (2.0**53 - 1,)), None),  # two integers of eight bytes are longer than floats
    ],
)
def test_domains_are_written_as_decimals_or_floats(domain, data):
    is_floats = data is None
    expected = struct.pack(f"<{2 * domain.dim}d", *domain.lo, *domain.hi) if is_floats else bytes(data)
    assert domain_to_bytes(domain) == (expected, is_floats)
    assert read(expected, domain.dim, is_floats) == domain


def test_decimal_context_of_the_caller_has_no_effect():
    domain = Box((-1234.5678,), (8765.4321,))
    expected = domain_to_bytes(domain)
    with decimal.localcontext(decimal.Context(prec=3, traps=[decimal.Inexact, decimal.Rounded])):
        assert domain_to_bytes(domain) == expected
    assert not expected[1]


@pytest.mark.parametrize(
    ("data", "is_floats", "message"),
    [
        (b"\x00\x00", False, "end too early"),
        (b"\x17\x00\x02", False, "coordinates of 23 decimals, more than 22"),
        (b"\x00\x00" + signed_varint(2**53 + 1), False, "coordinates that are too large"),
        (b"\x00" + signed_varint(-(2**60)) + b"\x00", False, "coordinates that are too large"),
        (b"\x00\x02\x02", False, "positive width along every axis, got lo=1 and hi=1 on axis 0"),
        (bytes(15), True, "end too early"),
        (bytes(16), True, "positive width"),
        (struct.pack("<2d", np.inf, 0), True, "finite"),
    ],
)
def test_invalid_domains_raise(data, is_floats, message):
    with pytest.raises(ValueError, match=message):
        read_domain(ByteReader(data), 1, is_floats)


# The container: it may be cut off only at the ends of layers, and has one form of bytes only.


DOMAIN = Box((-1, 0), (1, 3))
CORNERS = bytes([0, 1, 0, 2, 6])  # no decimals; -1, 0, 1 and 3 with the sign as the lowest bit
BODY = (Layer(2, b"body"),)
ONE = Container(DOMAIN, BODY)
THREE = Container(DOMAIN, (Layer(1, b"one", 3), Layer(3, b""), Layer(7, b"three", 2)), label="Übersicht")
WINDOW = Box((-2, -2, -np.pi), (2, 2, np.pi), periodic=(False, False, True))
FOLDED = Container(WINDOW, (Layer(0, b"whole"),), folding_of(ReedsShepp((0.1, 0, 0.4), 1), WINDOW))
CONTAINERS = [ONE, THREE, FOLDED, Container(Box(np.zeros(17), np.ones(17)), (Layer(0, b"a"), Layer(7, b"b")))]


def crc(*parts):
    return struct.pack("<I", zlib.crc32(b"".join(parts)))


def test_layers_are_written_as_by_hand():
    label = "Übersicht".encode()
    extension = bytes([10]) + label + bytes([2, 1 + 3 + 4, 1 + 0 + 4])
    header = b"P\xb5" + bytes([5 | 2 << 4, 7 | 2 << 3 | 1 << 6]) + CORNERS + extension
    first, second, last = bytes([1 | 3 << 4]) + b"one", bytes([3]), b"three"
    checksums = crc(header, first), crc(header, first, second), crc(header, first, second, last)
    parts = [header, first, checksums[0], second, checksums[1], last, checksums[2]]
    assert THREE.to_bytes() == b"".join(parts)
    assert THREE.last == THREE.layers[2]
    assert Header.read(THREE.to_bytes()).marks == (len(header) + 8, len(header) + 13)


BODIES, PROOFS = st.binary(max_size=300), st.integers(0, 3)
OF_PAIRS = st.lists(st.builds(Layer, st.just(PAIRS_CODE), BODIES, PROOFS), min_size=1, max_size=33)
ALONE = st.lists(st.builds(Layer, st.integers(0, 7), BODIES, PROOFS), min_size=1, max_size=1)


@given(layers=OF_PAIRS | ALONE, label=st.sampled_from(["", "ä", 1000 * "x"]), dim=st.integers(1, 20))
def test_containers_and_their_first_layers_are_read_as_written(layers, label, dim):
    container = Container(Box(np.zeros(dim), np.arange(1.0, dim + 1)), tuple(layers), label=label)
    data = container.to_bytes()
    assert Container.from_bytes(data) == container
    if len(layers) == 1:
        assert len(data) == frame_size(container.domain, label=label) + len(layers[0].body)
    marks = Header.read(data).marks
    assert len(marks) == len(layers) - 1
    for number, mark in enumerate(marks, 1):
        cut = Container.from_bytes(data[:mark])
        assert cut == Container(container.domain, tuple(layers[:number]), label=label)
        assert Container.from_bytes(cut.to_bytes()) == cut


@pytest.mark.parametrize("whole", [THREE, FOLDED])
def test_flipped_bits_and_cut_or_longer_files_raise(whole):
    data = whole.to_bytes()
    flipped = [data[:at] + bytes([data[at] ^ 1 << at % 8]) + data[at + 1 :] for at in range(len(data))]
    cut = [data[:end] for end in set(range(len(data))) - {*Header.read(data).marks}]
    for damaged in (*flipped, *cut):
        with pytest.raises(ValueError):
            Container.from_bytes(damaged)
    for more in (b"\0", data):
        with pytest.raises(ValueError, match="checksum does not match: the file is truncated or corrupt"):
            Container.from_bytes(data + more)


def layered(sizes, *parts):
    """Return a file whose header states any sizes of layers; all checksums are right."""
    data = content = b"P\xb5\x25\x47" + CORNERS + b"\0" + varint(len(sizes)) + b"".join(map(varint, sizes))
    for part in parts:
        content += part
        data += part + crc(content)
    return data


def test_wrong_sizes_of_layers_raise():
    assert Container.from_bytes(layered([6], b"\0a", b"b")).layers == (Layer(0, b"a"), Layer(7, b"b"))
    for sizes in ([5], [7], [6, 6], [5, 6], [11], [12], [2**69]):
        with pytest.raises(ValueError, match=r"checksum|too early"):
            Container.from_bytes(layered(sizes, b"\0a", b"b"))
    for size in (0, 1, 4, 9, 10, 2**32, 2**63):
        for parts in ((), (b"", b""), (b"body",)):
            with pytest.raises(ValueError, match="too early"):
                Container.from_bytes(layered([size], *parts))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"", "does not start like a PLR file"),
        (lambda data: b"P\xb4" + data[2:], "does not start like a PLR file"),
        (lambda data: data[:2], "the data end too early"),
        (lambda data: data[:12], "the data end too early"),
        (lambda data: b"P\xb5\x29" + data[3:], "version 9, this release reads versions 5 to 8; update plr_jax"),
        (lambda data: b"P\xb5\x24" + data[3:], "format version 4, this release reads versions 5 to 8; build it"),
        (lambda data: b"P\xb5\x26\x07" + data[4:], "it names goals or leaves of distances between any two points"),
        (lambda data: b"PLR\n\x02" + data, "it must have format version 5, but has an earlier one; build it again"),
        (lambda data: b"CPL\n\x01" + data, "it must have format version 5, but has an earlier one; build it again"),
        (lambda data: sealed(b"P\xb5\x05\x02\x00" + data[4:-4]), "it must have 1 to 255 axes, but states 0"),
        (lambda data: sealed(b"P\xb5\x05\x02\x80\x02" + data[4:-4]), "it must have 1 to 255 axes, but states 256"),
        (lambda data: sealed(data[:5] + b"\x02" + data[6:-4]), "positive width"),
    ],
)
def test_invalid_containers_raise(change, message):
    with pytest.raises(ValueError, match=message):
        Container.from_bytes(change(ONE.to_bytes()))


@pytest.mark.parametrize(
    "header",
    [
        b"\x05\x02\x02" + CORNERS,  # the number of axes in a byte of its own
        b"\x05\x02\x91\x00" + bytes(1 + 17) + b"\x02" * 17,  # in two
        b"\x25\x82" + struct.pack("<4d", -1, 0, 1, 3),  # floats where decimals are shorter
        b"\x25\x02" + bytes([1, 19, 0, 20, 60]),  # decimals that are all zero
        b"\x25\x02" + bytes([0, 1, 0x80, 0, 2, 6]),  # a zero of two bytes
        b"\x25\x42" + CORNERS + b"\0\0",  # neither a label nor layers
        b"\x25\x42" + CORNERS + b"\x81\0a\0",  # the label's length in two bytes
        b"\x15\x02" + bytes([16]) + bytes([0]) + varint(2 * 9007199254740989),  # a float with a shorter decimal
    ],
)
def test_headers_not_in_canonical_form_raise(header):
    with pytest.raises(ValueError, match="its header is not in canonical form"):
        Container.from_bytes(sealed(b"P\xb5" + header + b"\0body"))


LABELED = b"\x25\x42" + CORNERS


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\x05\x02" + b"\xff" * 50, "a number that is too large"),
        (b"\x05\x82" + varint(2**69) + bytes(50), f"must have 1 to 255 axes, but states {2**69}"),
        (b"\x25\x02\x00" + b"\xff" * 50, "a number that is too large"),
        (LABELED + varint(1001) + bytes(5000), "a label of 1001 bytes"),
        (LABELED + varint(900), "too early"),
        (LABELED + b"\x02\xc3\x28\0", "its label is no text"),
        (LABELED + b"\x02\xc0\x80\0", "its label is no text"),  # a zero in two bytes
        (LABELED + b"\x03\xed\xa0\x80\0", "its label is no text"),  # half a surrogate pair
        (LABELED + b"\0" + varint(33) + bytes(50), "it states 33 layers, more than 32"),
        (b"\x25\x47" + CORNERS + b"\0\x20" + varint(2**69) * 32 + bytes(50), "too early"),
        (LABELED + b"\0\x01\x06" + bytes(50), "it is a progressive file .* only plr_jax 0.1 reads"),
        (b"\x25\x22" + CORNERS + bytes(16) + b"\0\xff" + bytes(50), "too early"),  # 255 mirrors
    ],
)
def test_headers_that_promise_much_raise_before_allocation(data, message):
    assert_refused_for_little(Container.from_bytes, sealed(b"P\xb5" + data), message, 2**20)


@given(st.data())
def test_forged_headers_raise_or_are_canonical(data):
    whole = bytearray(data.draw(st.sampled_from(CONTAINERS)).to_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(2, min(60, len(whole) - 1)))] = data.draw(st.integers(0, 255))
    try:
        header = Header.read(bytes(whole))
    except ValueError:
        return
    assert whole.startswith(header.data)
    assert Header.read(header.data).data == header.data


def test_too_many_axes_or_bytes_raise(monkeypatch):
    with pytest.raises(ValueError, match=r"A domain must have at most 255 axes, got 256\."):
        frame_size(Box(np.zeros(256), np.ones(256)))
    data = ONE.to_bytes()
    monkeypatch.setattr(container_module, "MOST_BYTES", len(data))
    assert Container.from_bytes(data) == ONE
    with pytest.raises(ValueError, match="it has more than 17 bytes"):
        Container.from_bytes(data + b"\0")


# Objects that hold a file.


@pytest.fixture(scope="module", params=["one goal", "pairs"])
def held(request):
    if request.param == "pairs":
        return plr_jax.construct_pairs(plr_jax.Workspace(((0, 0), (1, 1))), max_bytes=200)
    return plr_jax.construct(plr_jax.Euclidean((0.0, 0.0)), ((0, 0), (1, 1)), max_leaves=8)


def test_labels_change_only_the_file(held, tmp_path):
    assert held.label == "" and held.with_label("") is held
    assert held.resident_bytes == sum(a.nbytes for a in jax.tree_util.tree_leaves(held.tables)) > 0
    labeled = held.with_label("Räume, goal (0, 0)")
    again = labeled.with_label("")
    assert again.to_bytes() == held.to_bytes() and labeled.num_bytes > held.num_bytes == again.num_bytes
    for one, other in zip(*map(jax.tree_util.tree_leaves, (labeled.tables, held.tables)), strict=True):
        np.testing.assert_array_equal(one, other)
    assert held.with_label("x" * 1000).label == "x" * 1000
    for one in (held, labeled):
        plr_jax.save(one, tmp_path / "file")
        assert (tmp_path / "file").read_bytes() == one.to_bytes() and len(one.to_bytes()) == one.num_bytes
        again = plr_jax.load(tmp_path / "file")
        assert type(again) is type(held) and again.label == one.label and again.to_bytes() == one.to_bytes()


@given(st.binary(max_size=2000), st.integers(-6, 6))
def test_bytes_are_padded_to_powers_of_two(data, more):
    data = (data + bytes(1000))[: max(0, padded_size(len(data)) + more)]
    array = container_module.padded_file(data)
    assert len(array).bit_count() == 1 and len(data) + 4 <= len(array) <= 2 * (len(data) + 4)
    found = container_module.FileBacked()
    found.file = array
    assert found.to_bytes() == data and found.num_bytes == len(data)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("label", ["x" * 1001, "ä" * 501, "\ud800", b"text"])
def test_invalid_labels_raise(held, label):
    with pytest.raises(ValueError, match="label must be text of up to 1,000 UTF-8 bytes, got"):
        held.with_label(label)
