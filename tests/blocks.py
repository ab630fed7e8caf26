"""A block of samples as a whole message."""

import numpy as np

from rig.recording.messages import block_head


def encode_block(time_ns, first_sample, sample_rate_hz, values):
    return block_head(time_ns, first_sample, sample_rate_hz, values.shape) + np.asarray(values, "<f8").tobytes()
