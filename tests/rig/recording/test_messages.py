"""The two messages, read with nothing but their published formats."""

import struct

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from rig.recording.messages import BLOCK_NAME, BLOCK_SCHEMA, decode_block, preview_head
from tests.blocks import encode_block

values = arrays(float, array_shapes(min_dims=2, max_dims=2, max_side=40), elements=st.floats(width=64))


def plain_protobuf(data):
    """A block as protobuf's own parser sees it, from the schema that is stored in every file."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(BLOCK_SCHEMA).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(BLOCK_NAME)).FromString(data)


@given(values, st.integers(0, 2**62), st.integers(0, 2**40))
def test_a_block_is_a_plain_protobuf_message(block, time_ns, first_sample):
    message = plain_protobuf(encode_block(time_ns, first_sample, 512.5, block))
    assert message.timestamp.ToNanoseconds() == time_ns
    assert (message.first_sample, message.sample_rate_hz, message.channels) == (first_sample, 512.5, len(block))
    np.testing.assert_array_equal(np.array(message.values).reshape(block.shape), block)  # channel by channel
    message.DiscardUnknownFields()
    assert encode_block(time_ns, first_sample, 512.5, block) == message.SerializeToString()


@given(values, st.integers(0, 2**62), st.integers(0, 2**40))
def test_a_block_survives(block, time_ns, first_sample):
    decoded = decode_block(encode_block(time_ns, first_sample, 4096.0, block))
    assert (decoded.time_ns, decoded.first_sample, decoded.sample_rate_hz) == (time_ns, first_sample, 4096.0)
    np.testing.assert_array_equal(decoded.values, block)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"\xff\xff\xff", "cannot be decoded"),
        (encode_block(0, 0, 1.0, np.zeros((2, 3)))[:-1], "cannot be decoded"),
        (b"", "0 values for 0 channels"),
        (plain_protobuf(b"").__class__(channels=2, values=[1.0, 2.0, 3.0]).SerializeToString(), "3 values for 2"),
    ],
)
def test_what_is_no_block_is_refused(data, reason):
    with pytest.raises(ValueError, match=reason):
        decode_block(data)


@given(arrays(float, st.integers(1, 20), elements=st.floats(width=64)))
def test_a_preview_is_a_float64_multi_array_in_cdr(channels):
    data = preview_head(channels.size) + channels.tobytes()
    assert data[:4] == bytes([0, 1, 0, 0])  # CDR, little-endian
    body = data[4:]
    dimensions, offset, count = struct.unpack_from("<III", body)
    assert (dimensions, offset, count) == (0, 0, channels.size)
    start = 16  # doubles begin at a multiple of eight
    np.testing.assert_array_equal(np.frombuffer(body[start:], "<f8"), channels)
