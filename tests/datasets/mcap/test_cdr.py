"""The layout of CDR messages against the serializer of rosbags, both ways; and bytes that are no message."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from stillpoint.datasets.mcap import cdr
from stillpoint.datasets.mcap.topics import TOPICS

STORE = get_typestore(Stores.ROS2_HUMBLE)
PAIR = "trap_msgs/msg/Pair"
TRAP = "trap_msgs/msg/Trap"
TRAP_TEXT = f"""# every alignment there is, and what a parser trips over: '#' in a text, constants, defaults, bounds
uint8 KIND=3
string GREETING="hello # world = 1"
bool first
float64[] maybe_empty
uint8 after_empty
string<=9 word "none"
float32[3] triple
Pair[<=4] pairs
char letter
int16[2] two
int64 big
string[] names
byte last
{"=" * 80}
MSG: trap_msgs/Pair
uint8 a   # then seven bytes of nothing
float64 b
"""
STORE.register(get_types_from_msg(TRAP_TEXT, TRAP))
TYPES = sorted(
    {topic.type_name for topic in TOPICS}
    | {"nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/Range", "std_msgs/msg/Empty", TRAP}
)


def text_of(type_name):
    return TRAP_TEXT if type_name == TRAP else cdr.get_definition(type_name)


def random_value(node, rng):
    kind, detail = node
    if kind == Nodetype.NAME:
        return random_message(detail, rng)
    if kind == Nodetype.BASE:
        if detail[0] == "string":
            return "".join(rng.choice(list("abc/_"), rng.integers(0, 9)))
        dtype = np.dtype("u1" if detail[0] == "bool" else cdr.PRIMITIVES[detail[0]])
        if dtype.kind == "f":
            return float(dtype.type(rng.normal()))
        return int(rng.integers(2 if detail[0] == "bool" else 100))
    count = detail[1] if kind == Nodetype.ARRAY else int(rng.integers(0, 4))
    values = [random_value(detail[0], rng) for _ in range(count)]
    if detail[0][0] == Nodetype.BASE and detail[0][1][0] != "string":
        return np.array(values, cdr.PRIMITIVES[detail[0][1][0]])
    return values


def random_message(type_name, rng):
    fields = {name: random_value(node, rng) for name, node in STORE.fielddefs[type_name][1]}
    return STORE.types[type_name](**fields)


def leaf_of(message, path):
    for step in re.findall(r"\w+|\[\d+\]", path):
        message = message[int(step[1:-1])] if step[0] == "[" else getattr(message, step)
    return message


def as_bytes(value):
    return value.encode() if isinstance(value, str) else value


@pytest.mark.parametrize("little", [True, False], ids=["little-endian", "big-endian"])
@pytest.mark.parametrize("type_name", TYPES)
def test_every_leaf_lies_where_rosbags_puts_it(type_name, little):
    parsed = cdr.parse(type_name, "ros2msg", text_of(type_name))
    for seed in range(12):
        message = random_message(type_name, np.random.default_rng(seed))
        body = bytes(STORE.serialize_cdr(message, type_name, little_endian=little))
        layout = cdr.find_layout(parsed, body)
        record = np.frombuffer(body, layout.dtype)[0]
        assert all(body[at : at + len(word)] == word for at, word in layout.words)
        for path in layout.dtype.names:
            np.testing.assert_array_equal(record[path], as_bytes(leaf_of(message, path)), err_msg=path)
        if layout.dtype.names:
            last, at, *_ = layout.dtype.fields[layout.dtype.names[-1]]
            assert 0 <= len(body) - at - last.itemsize <= 1  # nothing but the NUL of a last string is left over


@pytest.mark.parametrize("type_name", TYPES)
def test_a_message_built_from_a_layout_is_that_of_rosbags_byte_for_byte(type_name):
    parsed = cdr.parse(type_name, "ros2msg", text_of(type_name))
    for seed in range(12):
        message = random_message(type_name, np.random.default_rng(seed))
        body = bytes(STORE.serialize_cdr(message, type_name))
        found = cdr.find_layout(parsed, body)
        lengths = {}

        def note(path, at, empty, lengths=lengths, body=body):
            lengths[path] = int.from_bytes(body[at : at + 4], "little")
            return lengths[path]

        cdr._Walk("<", note, len(body)).layout(parsed)
        layout = cdr.make_layout(parsed, lengths)
        built = np.zeros(1, layout.dtype)
        raw = built.view(np.uint8)
        for at, word in layout.words:
            raw[at : at + len(word)] = np.frombuffer(word, np.uint8)
        for path in found.dtype.names:
            built[0][path] = as_bytes(leaf_of(message, path))
        assert built.tobytes() == body


def test_padding_of_a_layout_agrees_with_the_specification():
    """NavSatStatus: an int8, one byte of padding, a uint16; then the doubles at 8 from the body's start."""
    parsed = cdr.parse("a/msg/T", "ros2msg", "int8 s\nuint16 v\nfloat64 x\nuint8 c")
    body = b"\0\1\0\0" + b"\xff\0\x02\x01" + b"\0" * 4 + np.float64(1.5).tobytes() + b"\x07"
    record = np.frombuffer(body, cdr.find_layout(parsed, body).dtype)[0]
    assert record.tolist() == (-1, 258, 1.5, 7)


@pytest.mark.parametrize(
    ("head", "says"),
    [(b"\0\7\0\0", "not plain CDR"), (b"\0\3\0\0", "not plain CDR"), (b"\0\1", "not plain CDR"), (b"", "nothing")],
)
def test_other_encodings_are_named(head, says):
    parsed = cdr.parse("a/msg/T", "ros2msg", "uint8 x")
    with pytest.raises(cdr.Undecodable, match=says):
        cdr.find_layout(parsed, head)


@given(st.sampled_from(TYPES), st.integers(0, 30), st.binary(max_size=8), st.integers(0, 400))
def test_no_bytes_bring_anything_but_undecodable(type_name, seed, noise, at):
    """Cut and overwritten messages have a layout within their bytes, or none; a length of 2^32 asks for no memory."""
    message = random_message(type_name, np.random.default_rng(seed))
    body = bytearray(bytes(STORE.serialize_cdr(message, type_name)))
    body[at : at + len(noise)] = noise
    del body[at + 100 :]
    try:
        layout = cdr.find_layout(cdr.parse(type_name, "ros2msg", text_of(type_name)), bytes(body))
    except cdr.Undecodable:
        return
    assert layout.dtype.itemsize == len(body)


@pytest.mark.parametrize(
    ("encoding", "text", "says"),
    [
        ("protobuf", "", "its schema is protobuf"),
        ("ros2msg", "float64", "cannot be parsed"),
        ("ros2msg", "Missing x", "does not define"),
        ("ros2msg", "T x", "holds itself"),
        ("ros2msg", "wstring x", "does not define|wstring"),
    ],
)
def test_definitions_that_cannot_be_used_are_named(encoding, text, says):
    with pytest.raises(cdr.Undecodable, match=says):
        cdr.find_layout(cdr.parse("a/msg/T", encoding, text), b"\0\1\0\0" + b"\0" * 64)


def test_an_idl_schema_has_the_same_layout():
    idl = """module geometry_msgs { module msg { struct Vector3 { double x; double y; double z; }; }; };"""
    body = b"\0\1\0\0" + np.arange(3.0).tobytes()
    parsed = cdr.parse("geometry_msgs/msg/Vector3", "ros2idl", idl)
    assert np.frombuffer(body, cdr.find_layout(parsed, body).dtype)[0].tolist() == (0.0, 1.0, 2.0)


def test_a_definition_comes_whole_with_all_that_it_is_made_of():
    text = cdr.get_definition("sensor_msgs/msg/Imu")
    assert {"MSG: std_msgs/Header", "MSG: geometry_msgs/Vector3"} <= set(text.splitlines())
