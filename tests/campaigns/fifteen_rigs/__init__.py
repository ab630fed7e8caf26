"""Fifteen rigs as people have them, from nothing to a clearance by what the READMEs say, on a simulator of its own."""
