"""A chunk of an MCAP file in the making: its messages are put where the file will have them, without other copies."""

import struct
from collections import Counter
from functools import cache

import numpy as np
from jaxtyping import Float, UInt
from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from zlib_ng.zlib_ng import crc32

_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQIIQ")  # times, size, checksum, no compression, size of the records
_MESSAGE = struct.Struct("<BQHIQQ")
_INDEX = struct.Struct("<BQHI")
_PLACE = struct.Struct("<QQ")
_START = _HEAD.size + _CHUNK.size


class Chunk:
    """Messages that will be a chunk, in one piece: a write each to the file costs more than all else."""

    def __init__(self, start: bytes = b"") -> None:
        """`start` are records that stand before the messages. `counts` are all messages of a channel, ever."""
        self._bytes = np.empty(_START, "u1")
        self._end = _START
        self._index: dict[int, list[bytes]] = {}
        self._times_ns: list[int] = []
        self.counts: Counter[int] = Counter()
        self._put(start)

    @property
    def size(self) -> int:
        return self._end - _START

    @property
    def filled(self) -> bool:
        return bool(self._index)

    def add(
        self, channel: int, time_ns: int, sequence: int, head: bytes, values: Float[np.ndarray, "channels samples"]
    ) -> None:
        """One message: its head, and the doubles channel by channel."""
        length = _MESSAGE.size - _HEAD.size + len(head) + 8 * values.size
        front = _MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence, time_ns, time_ns) + head
        self._index.setdefault(channel, []).append(_PLACE.pack(time_ns, self.size))
        self._times_ns.append(time_ns)
        self.counts[channel] += 1
        self._put(front)
        self._room(8 * values.size).view("<f8").reshape(values.shape)[:] = values

    def add_many(
        self,
        channel: int,
        times_ns: UInt[np.ndarray, " messages"],
        head: bytes,
        values: Float[np.ndarray, "messages channels"],
    ) -> None:
        """Messages of the same head and as many doubles."""
        kind = _alike(len(head), values.shape[1])
        places = self.size + kind.itemsize * np.arange(len(values), dtype="<u8")
        self._index.setdefault(channel, []).append(np.stack([times_ns, places], axis=1).tobytes())
        self._times_ns += [int(times_ns.min()), int(times_ns.max())]
        self.counts[channel] += len(values)
        records = self._room(len(values) * kind.itemsize).view(kind)
        records["opcode"], records["sequence"], records["channel"] = Opcode.MESSAGE, 0, channel
        records["length"] = kind.itemsize - _HEAD.size
        records["log"] = records["publish"] = times_ns
        records["head"] = np.frombuffer(head, "u1")
        records["values"] = values

    def sealed(self, at: int) -> tuple[UInt[np.ndarray, " bytes"], ChunkIndex]:
        """The chunk's record at that place of the file with the message indexes behind it, and its own index.

        From then on the chunk is empty; the bytes are there until the next message comes.
        """
        size, length = self.size, self._end
        begin, end = min(self._times_ns), max(self._times_ns)
        crc = crc32(self._bytes[_START:length])
        front = _HEAD.pack(Opcode.CHUNK, length - _HEAD.size) + _CHUNK.pack(begin, end, size, crc, 0, size)
        self._bytes[:_START] = np.frombuffer(front, "u1")
        places = {}
        for channel, found in self._index.items():
            places[channel], pairs = at + self._end, b"".join(found)
            head = _INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX.size - _HEAD.size + len(pairs), channel, len(pairs))
            self._put(head + pairs)
        data = self._bytes[: self._end]
        self._end, self._index, self._times_ns = _START, {}, []
        return data, ChunkIndex(
            chunk_length=length,
            chunk_start_offset=at,
            compression="",
            compressed_size=size,
            message_end_time=end,
            message_index_length=data.size - length,
            message_index_offsets=places,
            message_start_time=begin,
            uncompressed_size=size,
        )

    def _put(self, data: bytes) -> None:
        self._room(len(data))[:] = np.frombuffer(data, "u1")

    def _room(self, length: int) -> UInt[np.ndarray, " length"]:
        """So many bytes at the end, to be filled."""
        begin, self._end = self._end, self._end + length
        if self._end > self._bytes.size:
            self._bytes = np.concatenate([self._bytes[:begin], np.empty(2 * self._end - begin, "u1")])
        return self._bytes[begin : self._end]


@cache
def _alike(head: int, doubles: int) -> np.dtype[np.void]:
    """Of a message with so many bytes before so many doubles."""
    before = [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8")]
    return np.dtype([*before, ("publish", "<u8"), ("head", "u1", (head,)), ("values", "<f8", (doubles,))])
