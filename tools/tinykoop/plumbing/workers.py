"""Calls side by side: on all cores, or on a Dask cluster."""

from contextlib import contextmanager

from joblib import Parallel, delayed, parallel_config

from . import checkout
from .errors import UserError
from .results import progress


@contextmanager
def workers(cluster=None, jobs=None):
    """All cores, or the Dask cluster at an address; its workers must have this package."""
    if cluster is None:
        with parallel_config("loky", n_jobs=jobs or -1):
            yield
        return
    try:
        from distributed import Client
    except ImportError:
        raise UserError(f"--cluster: the package distributed is missing; install it: {checkout.install('blind')}")
    try:
        client = Client(cluster, timeout=10)
    except (OSError, ValueError) as error:
        raise UserError(f"--cluster {cluster}: no Dask scheduler answers there ({type(error).__name__})")
    with client, parallel_config("dask", n_jobs=jobs or -1):
        yield


def each(function, calls, description):
    """Results as they come, with a progress bar over them."""
    results = Parallel(return_as="generator_unordered")(delayed(function)(*call) for call in calls)
    for _ in progress(range(len(calls)), description):
        yield next(results)
