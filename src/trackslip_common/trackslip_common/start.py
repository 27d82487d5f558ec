# SPDX-License-Identifier: Apache-2.0
"""Starts an executable so that Ctrl-C is quiet from the first moment, while its imports are still loading."""

import importlib
import os
import signal
import sys
from typing import NoReturn

from trackslip_common.errors import ExitCode


def start(module: str, interrupted: ExitCode = ExitCode.DONE) -> NoReturn:
    """Import ``module`` and leave with what its ``main`` returns, or as ``interrupted`` by an early Ctrl-C.

    A job that a shell put in the background ignores SIGINT from the start; here it receives it again.
    """
    signal.signal(signal.SIGINT, lambda *_: os._exit(interrupted))  # nothing is open yet
    main = importlib.import_module(module).main
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.exit(main())
