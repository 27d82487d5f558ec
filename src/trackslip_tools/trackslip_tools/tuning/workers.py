# SPDX-License-Identifier: Apache-2.0
"""Who does the scoring: the cores of this machine, or a Dask cluster; the scores are the same."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

from joblib import Parallel, delayed

from trackslip_common.errors import InputError
from trackslip_tools.tuning.task import Score, Task

Job = tuple[int, Mapping[str, float]]
"""Number of the bag, values."""

Work = Callable[[Sequence[Job]], Iterator[Score]]
"""Scores of the jobs, in their order."""

_ANSWERS = 10.0  # s in which a scheduler answers


@contextmanager
def cores(tasks: Sequence[Task], count: int) -> Iterator[Work]:
    """``count`` cores of this machine, -1 for all; the kernels hold no lock, so threads do."""
    with Parallel(n_jobs=count, prefer="threads", return_as="generator") as pool:

        def work(jobs: Sequence[Job]) -> Iterator[Score]:
            yield from pool(delayed(tasks[bag].score)(values) for bag, values in jobs)

        yield work


@contextmanager
def cluster(tasks: Sequence[Task], address: str) -> Iterator[Work]:
    """The workers of a Dask scheduler, which have trackslip_estimation installed; each gets the bags once.

    Raises:
        InputError: no scheduler answers there.
    """
    from distributed import Client  # takes a second: only where it is asked for

    try:
        client = Client(address, timeout=_ANSWERS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers; accepted: tcp://host:port"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_ANSWERS)
            sent = client.scatter(list(tasks), broadcast=True)
        except TimeoutError as error:
            raise InputError(f"--scheduler {address}: it has no workers; accepted: one at least") from error

        def work(jobs: Sequence[Job]) -> Iterator[Score]:
            futures = [client.submit(Task.score, sent[bag], values, pure=False) for bag, values in jobs]
            for future in futures:
                try:
                    score = future.result()
                except ModuleNotFoundError as error:
                    raise InputError(f"--scheduler {address}: its workers lack {error.name}") from error
                yield score

        yield work
