# SPDX-License-Identifier: Apache-2.0
"""The grid of a study, cell by cell; the runs of a cell share the cores: kernels hold no lock."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

from trackslip_estimation.slip_parameters import SlipEstimatorParameters
from trackslip_sim.study.cache import Cache, key_of
from trackslip_sim.study.drive import make_drive
from trackslip_sim.study.evaluate import evaluate
from trackslip_sim.study.parameters import StudyParameters, cells
from trackslip_sim.study.results import Row


def run_study(
    p: StudyParameters, estimator: SlipEstimatorParameters, cache: Cache, jobs: int | None = None
) -> Iterator[Row]:
    """The rows in the order of the grid; those in the cache are not computed again.

    Raises:
        InputError: scenario or a soil is unknown or refused; before the first row.
    """
    keys = {cell: key_of(cell, p, estimator) for cell in cells(p)}
    soils = dict.fromkeys(cell.soil for cell, key in keys.items() if cache.get(key) is None)
    drives = {soil: make_drive(p, estimator, soil) for soil in soils}
    pool = ThreadPoolExecutor(jobs)
    try:
        for cell, key in keys.items():
            row = cache.get(key)
            if row is None:
                row = evaluate(cell, drives[cell.soil], p, estimator, pool.map)
                cache.add(key, row)
            yield row
    finally:
        pool.shutdown(cancel_futures=True)
