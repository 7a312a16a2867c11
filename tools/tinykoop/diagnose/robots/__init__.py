"""Robots: those of TOML files, of Python files, and those that come with TinyKoop."""
