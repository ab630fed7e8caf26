"""Settings of the whole suite: hypothesis without a clock, since the first call may compile."""

from hypothesis import settings

settings.register_profile("physics", deadline=None, max_examples=60)
settings.load_profile("physics")
