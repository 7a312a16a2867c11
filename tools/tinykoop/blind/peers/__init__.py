"""Peers of the diagnoser: other ways to name a cause, on the same logs and scored alike.

A peer takes (log, fresh log or None, effects that it may not name) and returns a dict as report.json has it. The
extra packages are in tools/requirements-peers.txt; each module says what its peer is and where it comes from.
"""

from . import boosting, joint_ls, one_step, sindy

PEERS = {"joint_ls": joint_ls.peer, "sindy": sindy.peer, "boosting": boosting.peer, "one_step": one_step.peer}
