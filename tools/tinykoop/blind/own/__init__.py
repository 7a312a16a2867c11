"""The diagnoser on simulated logs of your own robots, with sealed labels: drawn, sealed, diagnosed, scored.

A plant is one file here and one line of ROBOTS. Its code is not that of the robot's simulator: commands and sensors act in steps
much shorter than a row (`plant`), the motion is integrated otherwise, or by another time step of the engine.
"""

from . import arm, car, pendulum, quadrotor, two_wheeler

ROBOTS = {module.NAME: module for module in (car, pendulum, quadrotor, arm, two_wheeler)}
