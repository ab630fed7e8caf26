"""A diagnosis for people: a page that stands alone, its pictures, and the table on the screen."""
