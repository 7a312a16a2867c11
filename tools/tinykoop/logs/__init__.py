"""What is done with one log of a robot: replay, fit, changes; and flights drawn as logs."""
