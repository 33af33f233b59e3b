"""A Dask cluster on this machine, of processes that end with it."""

from contextlib import contextmanager


@contextmanager
def local_cluster(workers, *, protocol="tcp", security=None):
    """One of `workers`; nothing of it can be reached from outside.

    Several may run side by side. Dask would start its page at a fixed port, also where it is
    turned off.
    """
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host=f"{protocol}://127.0.0.1",
        dashboard_address="127.0.0.1:0",
        worker_dashboard_address="127.0.0.1:0",
        security=security,
    ) as cluster:
        yield cluster
