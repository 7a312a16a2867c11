"""From windows of a log and a simulator to causes. Knows no robot, no unit, and no effect by name."""
