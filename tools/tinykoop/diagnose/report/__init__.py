"""A report told once, as sections of sentences, tables and figures, and rendered twice: on the terminal and as a page."""
