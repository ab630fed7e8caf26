"""The two message types of a recording: a protobuf block of samples, and a preview that any viewer plots."""

import struct
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from jaxtyping import Float

BLOCK_NAME = "rig.Block"
PREVIEW_NAME = "std_msgs/msg/Float64MultiArray"
PREVIEW_SCHEMA = b"""std_msgs/MultiArrayLayout layout
float64[] data
================================================================================
MSG: std_msgs/MultiArrayLayout
std_msgs/MultiArrayDimension[] dim
uint32 data_offset
================================================================================
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""


@dataclass(frozen=True)
class Block:
    """Consecutive samples of all channels of a group, from `first_sample` on."""

    time_ns: int
    first_sample: int
    sample_rate_hz: float
    values: Float[np.ndarray, "channels samples"]

    def with_copied_values(self) -> "Block":
        """Block with a copy of the values."""
        return replace(self, values=self.values.copy())


def block_head(time_ns: int, first_sample: int, sample_rate_hz: float, shape: tuple[int, int]) -> bytes:
    """Bytes before the little-endian doubles of a block with shape (channels, samples), channel by channel.

    A packed double field is its tag, its length in bytes and the doubles; protobuf would take them one by one.
    """
    channel_count, sample_count = shape
    head_message = _Block(first_sample=first_sample, sample_rate_hz=sample_rate_hz, channels=channel_count)
    head_message.timestamp.FromNanoseconds(time_ns)
    return bytes(head_message.SerializeToString()) + _VALUES_TAG + _encode_varint(8 * channel_count * sample_count)


def decode_block(message_bytes: bytes | memoryview) -> Block:
    """Block in a message; raises ValueError if there is none. Its values are a view of the data where possible."""
    decoded_message, (head_end, values_start) = _Block(), _values_offsets(message_bytes)
    try:
        decoded_message.ParseFromString(bytes(message_bytes[:head_end]))
    except Exception as error:  # protobuf's own error type differs between its implementations
        raise ValueError("a block cannot be decoded") from error
    values = (
        np.frombuffer(message_bytes, "<f8", offset=values_start)
        if values_start
        else np.array(decoded_message.values, dtype=float)
    )
    if decoded_message.channels == 0 or values.size % decoded_message.channels:
        raise ValueError(f"a block of {values.size} values for {decoded_message.channels} channels")
    return Block(
        decoded_message.timestamp.ToNanoseconds(),
        decoded_message.first_sample,
        decoded_message.sample_rate_hz,
        values.reshape(decoded_message.channels, -1),
    )


def preview_head(value_count: int) -> bytes:
    """Bytes before the little-endian doubles of a Float64MultiArray in CDR: no dimensions, no offset, the count.

    Four bytes of alignment follow.
    """
    return _CDR_EMPTY_LAYOUT + struct.pack("<II", value_count, 0)


_CDR_EMPTY_LAYOUT = bytes([0, 1, 0, 0]) + struct.pack("<II", 0, 0)  # encapsulation, dim[0], data_offset


def _values_offsets(message_bytes: bytes | memoryview) -> tuple[int, int]:
    """Offsets at which the fields before the values end and the doubles begin.

    The values must be the last field and contiguous; otherwise the end of the message, and 0.
    """
    offset = 0
    while offset < min(len(message_bytes), _MAX_HEAD_BYTES):
        field_start, tag, offset = offset, message_bytes[offset], offset + 1
        if tag == _VALUES_TAG[0]:
            field_length, offset = _decode_varint(message_bytes, offset)
            if field_length == len(message_bytes) - offset and field_length % 8 == 0:
                return field_start, offset
            break
        if tag & 7 == 1:
            offset += 8
        else:
            field_length, offset = _decode_varint(message_bytes, offset)
            offset += field_length if tag & 7 == 2 else 0
    return len(message_bytes), 0


def _decode_varint(message_bytes: bytes | memoryview, offset: int) -> tuple[int, int]:
    """Value of a varint, and the offset behind it."""
    number, shift_bits = 0, 0
    while offset < len(message_bytes) and shift_bits < 64:
        number |= (message_bytes[offset] & 0x7F) << shift_bits
        offset, shift_bits = offset + 1, shift_bits + 7
        if message_bytes[offset - 1] < 0x80:
            break
    return number, offset


def _encode_varint(number: int) -> bytes:
    varint_bytes = bytearray()
    while number > 0x7F:
        varint_bytes.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*varint_bytes, number])


def _block_class_and_schema() -> tuple[Any, bytes]:
    """Message class of a block and its schema (a FileDescriptorSet), built in code."""
    field_descriptor = descriptor_pb2.FieldDescriptorProto
    block_file = descriptor_pb2.FileDescriptorProto(
        name="rig/block.proto", package="rig", syntax="proto3", dependency=["google/protobuf/timestamp.proto"]
    )
    block_message = block_file.message_type.add(name="Block")
    for field_number, (field_name, field_type, field_label) in enumerate(
        [
            ("timestamp", field_descriptor.TYPE_MESSAGE, field_descriptor.LABEL_OPTIONAL),
            ("first_sample", field_descriptor.TYPE_UINT64, field_descriptor.LABEL_OPTIONAL),
            ("sample_rate_hz", field_descriptor.TYPE_DOUBLE, field_descriptor.LABEL_OPTIONAL),
            ("channels", field_descriptor.TYPE_UINT32, field_descriptor.LABEL_OPTIONAL),
            ("values", field_descriptor.TYPE_DOUBLE, field_descriptor.LABEL_REPEATED),
        ],
        start=1,
    ):
        added_field = block_message.field.add(name=field_name, number=field_number, type=field_type, label=field_label)
        if field_type == field_descriptor.TYPE_MESSAGE:
            added_field.type_name = ".google.protobuf.Timestamp"
    timestamp_file = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(timestamp_file)
    descriptors = descriptor_pool.DescriptorPool()
    descriptors.Add(timestamp_file)
    descriptors.Add(block_file)
    schema_bytes = descriptor_pb2.FileDescriptorSet(file=[timestamp_file, block_file]).SerializeToString()
    return message_factory.GetMessageClass(descriptors.FindMessageTypeByName("rig.Block")), schema_bytes


_Block, BLOCK_SCHEMA = _block_class_and_schema()
_VALUES_TAG = bytes([5 << 3 | 2])
_MAX_HEAD_BYTES = 64
