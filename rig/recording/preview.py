"""A look at a recording for people: each channel's least and largest sample of every fiftieth of a second."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from mcap.records import Channel as ChannelRecord

PREVIEW_HZ = 50.0


def preview_record(number: int, group: str, sensor: str, unit: str) -> ChannelRecord:
    """The channel of the previews of a sensor (or contact, or the force): of that name, so that a viewer shows it."""
    about = {"unit": unit, "shown": "least, largest"}
    topic = f"/rig/{group}/preview/{sensor}"
    return ChannelRecord(id=number, topic=topic, message_encoding="cdr", schema_id=2, metadata=about)


def previews(
    values: Float[np.ndarray, "channels samples"], sample_rate_hz: float, length: int
) -> tuple[Int[np.ndarray, " parts"], Float[np.ndarray, "channels parts 2"]]:
    """Previews: where the parts of blocks of that length begin, and the least and the largest sample of each."""
    begins = _begins(values.shape[1], length, max(1, round(sample_rate_hz / PREVIEW_HZ)))
    ends = [each.reduceat(values, begins, axis=1) for each in (np.minimum, np.maximum)]
    return begins, np.stack(ends, axis=2)


@lru_cache(maxsize=16)
def _begins(samples: int, length: int, step: int) -> Int[np.ndarray, " parts"]:
    return np.concatenate([np.arange(block, block + length, step) for block in range(0, samples, length)])
