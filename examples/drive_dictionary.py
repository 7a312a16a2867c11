"""The dictionary of drive_dictionary.c from parts: tinykoop dictionary export writes its C code."""

from tinykoop import Angles, Products

drive = Products([(0, 1)]) + Angles([2])
