"""Description of a rig as its owner believes it."""
