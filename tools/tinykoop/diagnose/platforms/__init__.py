"""Robots as the diagnoser takes them: those that come with TinyKoop, and one's own."""
