"""Search for effects that, put into the rig, explain the residual of a record."""
