"""How much storage lib/ needs."""

import ctypes as ct

from .library import call


class _Storage(ct.Structure):
    _fields_ = [
        (name, ct.c_size_t)
        for name in (
            "learner_sqrt",
            "learner_plain",
            "gate_sqrt",
            "gate_plain",
            "mpc_newton",
            "mpc_gradient",
            "mpc_rate",
            "supervisor",
            "model",
        )
    ]


def storage(n_lifted, n_states, n_inputs, horizon):
    """{what: reals} of the storage that lib/ needs: learner in both forms, controller, supervisor, stored model."""
    sizes = _Storage()
    counts = [ct.c_size_t(max(k, 0)) for k in (n_lifted, n_states, n_inputs, horizon)]
    call("tk_sizes", *counts, ct.byref(sizes))
    return {name: getattr(sizes, name) for name, _ in _Storage._fields_}
