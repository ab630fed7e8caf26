"""The gap between a recording of reality and the rig that its owner believes in: where, why, how far it shrinks."""
