"""Other methods on the recordings that this project identifies: a module a peer, one table of all."""
