# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Workers of a Dask scheduler: failures are reported in one line."""

import os
import signal

import pytest
from distributed import LocalCluster

from trackslip_common.errors import InputError
from trackslip_tools.workers import open_workers


@pytest.mark.slow
def test_a_worker_that_is_killed_with_what_all_pieces_share_is_named() -> None:
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None, protocol="tcp") as cluster:
        (nanny,) = cluster.workers.values()
        address = cluster.scheduler_address
        ended = pytest.raises(InputError, match="its workers ended")
        with open_workers(1, address, shared=nanny.pid) as map_items, ended:
            list(map_items(os.kill, [signal.SIGKILL]))  # shared is the pid of the worker's process
