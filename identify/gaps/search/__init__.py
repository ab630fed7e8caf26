"""Which effects, put into the rig, explain the residual of a record."""
