"""Settings of the whole suite: one BLAS thread a worker; hypothesis without a clock, as a first call may compile."""

import os

from hypothesis import settings

for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

settings.register_profile("physics", deadline=None, max_examples=60)
settings.load_profile("physics")
