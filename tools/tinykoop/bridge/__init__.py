"""From Python to C."""
