"""Robots as the diagnoser takes them: those that come with TinyKoop, and your own."""
