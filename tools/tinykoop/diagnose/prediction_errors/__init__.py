"""Prediction-error identification of unmodelled effects: knows no robot, no unit and no effect by name."""
