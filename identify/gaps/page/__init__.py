"""Presentation of a diagnosis: gap.html with its pictures, and the table on the screen."""
