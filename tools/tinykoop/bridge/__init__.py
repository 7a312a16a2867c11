"""The simulator and the estimators of host_sim/, through its one C interface."""

from .control import MODELS, MPC_GRADIENT, MPC_NEWTON, Controller, Mpc, Solution, Supervisor
from .ddr import ARC, EULER, LONG, MIDPOINT, SEMI_IMPLICIT, WARM_UP, Rollouts, Steps, simulate, windows
from .estimator import CHECK_DIAGONAL, CHECK_REFUSE, CHECK_REPORT, FLAGS, TRACES, TRUST, Estimator, lowpass, threshold
from .flapping_wing import FWMAV_SENSED, FWMAV_STATE, fwmav, fwmav_follow, fwmav_hover, fwmav_roll
from .logs import Log, read_columns, read_log, write_log
from .quadrotor import (
    QUADROTOR_CORRECTED,
    QUADROTOR_SENSED,
    QUADROTOR_STATE,
    hover_request,
    quadrotor,
    quadrotor_effects,
    quadrotor_follow,
    quadrotor_hover,
    quadrotor_parameters,
    quadrotor_roll,
    quadrotor_vehicle,
    vehicle_names,
)
from .regulators import Setting, dead_zones, regulator_names, regulators
from .sizes import storage
from .unmodelled import Effect, effects, families, formulas, remembering, usual_effect

__all__ = [
    "ARC", "CHECK_DIAGONAL", "CHECK_REFUSE", "CHECK_REPORT", "EULER", "FLAGS", "FWMAV_SENSED", "FWMAV_STATE", "LONG", "MIDPOINT",
    "MODELS", "MPC_GRADIENT", "MPC_NEWTON", "QUADROTOR_CORRECTED", "QUADROTOR_SENSED", "QUADROTOR_STATE", "SEMI_IMPLICIT", "TRACES", "TRUST", "WARM_UP", "Controller", "Effect", "Estimator",
    "Supervisor", "Log", "Mpc", "Rollouts", "Setting", "Solution", "Steps", "dead_zones", "effects", "families", "formulas", "fwmav", "fwmav_follow", "fwmav_hover", "fwmav_roll", "hover_request", "lowpass",
    "quadrotor", "quadrotor_effects", "quadrotor_follow", "quadrotor_hover", "quadrotor_parameters", "quadrotor_roll", "quadrotor_vehicle",
    "read_columns", "read_log", "regulator_names", "remembering", "regulators", "simulate", "storage", "threshold", "usual_effect", "vehicle_names", "windows", "write_log",
]  # fmt: skip
