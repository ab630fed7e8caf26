"""A chunk of an MCAP file in the making: its messages are put where the file will have them, without other copies."""

import struct
from collections import Counter
from functools import cache

import numpy as np
from jaxtyping import Float, UInt
from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from zlib_ng.zlib_ng import crc32, crc32_combine

_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQIIQ")  # times, size, checksum, no compression, size of the records
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_START = struct.Struct("<BQHI")  # up to its times
_INDEX = struct.Struct("<BQHI")
_PLACE = struct.Struct("<QQ")
_START = _HEAD.size + _CHUNK.size


class Chunk:
    """Messages that will be a chunk, in one piece: a write each to the file costs more than all else."""

    def __init__(self, start: bytes = b"") -> None:
        """`start` are records that stand before the messages. `counts` are all messages of a channel, ever."""
        self._bytes = bytearray(_START)
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

    @property
    def span_ns(self) -> int:
        """Span from the first message to the last, ns."""
        return self._times_ns[-1] - self._times_ns[0] if self._times_ns else 0

    def add(
        self,
        channel: int,
        time_ns: int,
        sequence: int,
        head: bytes,
        values: Float[np.ndarray, "channels samples"],
        published_ns: int | None = None,
    ) -> None:
        """One message: its head, and the doubles channel by channel; published when logged, or at its own time."""
        published = time_ns if published_ns is None else published_ns
        length = _MESSAGE.size - _HEAD.size + len(head) + 8 * values.size
        front = _MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence, time_ns, published) + head
        self._index.setdefault(channel, []).append(_PLACE.pack(time_ns, self.size))
        self._times_ns.append(time_ns)
        self.counts[channel] += 1
        self._put(front)
        begin = self._room(8 * values.size)
        np.ndarray(values.shape, "<f8", self._bytes, begin)[:] = values

    def add_many(
        self,
        channel: int,
        times_ns: UInt[np.ndarray, " messages"],
        head: bytes,
        values: Float[np.ndarray, "messages channels"],
    ) -> None:
        """Messages of the same head and as many doubles."""
        kind = _alike(len(head), values.shape[1])
        places = np.empty((len(values), 2), "<u8")
        places[:, 0], places[:, 1] = times_ns, self.size + kind.itemsize * np.arange(len(values))
        self._index.setdefault(channel, []).append(places.tobytes())
        self._times_ns += [int(times_ns[0]), int(times_ns[-1])]
        self.counts[channel] += len(values)
        begin = self._room(len(values) * kind.itemsize)
        records = np.ndarray(len(values), kind, self._bytes, begin)
        start = _MESSAGE_START.pack(Opcode.MESSAGE, kind.itemsize - _HEAD.size, channel, 0)
        records["start"] = np.frombuffer(start, "u1")
        records["times"] = times_ns[:, None]  # logged and published
        records["head"] = np.frombuffer(head, "u1")
        records["values"] = values

    def sealed(self, at: int) -> tuple[memoryview, int, ChunkIndex]:
        """The chunk's record at that place of the file with the message indexes behind it, their checksum, its index.

        From then on the chunk is empty; the bytes are there until the next message comes.
        """
        size, length = self.size, self._end
        begin, end = min(self._times_ns), max(self._times_ns)
        crc = crc32(memoryview(self._bytes)[_START:length])
        front = _HEAD.pack(Opcode.CHUNK, length - _HEAD.size) + _CHUNK.pack(begin, end, size, crc, 0, size)
        self._bytes[:_START] = front
        places = {}
        for channel, found in self._index.items():
            places[channel], pairs = at + self._end, b"".join(found)
            head = _INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX.size - _HEAD.size + len(pairs), channel, len(pairs))
            self._put(head + pairs)
        data = memoryview(self._bytes)[: self._end]
        crc = crc32(data[length:], crc32_combine(crc32(front), crc, size))
        index = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=at,
            compression="",
            compressed_size=size,
            message_end_time=end,
            message_index_length=len(data) - length,
            message_index_offsets=places,
            message_start_time=begin,
            uncompressed_size=size,
        )
        self._end, self._index, self._times_ns = _START, {}, []
        return data, crc, index

    def _put(self, data: bytes) -> None:
        begin = self._room(len(data))
        self._bytes[begin : self._end] = data

    def _room(self, length: int) -> int:
        """Offset of this many bytes at the end, to be filled."""
        begin, self._end = self._end, self._end + length
        if self._end > len(self._bytes):
            self._bytes = self._bytes[:begin] + bytearray(2 * self._end - begin)
        return begin


@cache
def _alike(head: int, doubles: int) -> np.dtype[np.void]:
    """Record type of a message with this many bytes before this many doubles."""
    start = ("start", "u1", (_MESSAGE_START.size,))
    return np.dtype([start, ("times", "<u8", (2,)), ("head", "u1", (head,)), ("values", "<f8", (doubles,))])
