# SPDX-License-Identifier: Apache-2.0
"""Runs one node from start to a quiet end: one line for bad input, no traceback on Ctrl-C."""

import signal
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from trackslip_common.errors import ExitCode, InputError
from trackslip_common.nodes.base import TrackslipNode

_POLL = 0.1  # s, the longest that a signal waits to be seen


def run(make_node: Callable[[], TrackslipNode[Any]], argv: Sequence[str] | None = None) -> int:
    """Spin the node until SIGINT or SIGTERM; returns the exit code."""
    stop = threading.Event()
    received: list[int] = []

    def on_signal(number: int, _frame: object) -> None:
        received.append(number)
        stop.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)
    try:
        rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
        node = make_node()
    except InputError as error:
        print(error, file=sys.stderr)
        return ExitCode.BAD_INPUT
    except (RuntimeError, InvalidParameterTypeException) as error:
        # rcl's own refusals, such as a parameter file that is not there, say what is wrong at the start
        print(str(error).splitlines()[0], file=sys.stderr)
        return ExitCode.BAD_INPUT
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        node.start()
        while not stop.is_set() and rclpy.ok():
            executor.spin_once(timeout_sec=_POLL)
    except ExternalShutdownException:
        pass
    except InputError as error:
        print(error, file=sys.stderr)
        return ExitCode.BAD_INPUT
    finally:
        node.stop()
        node.destroy_node()
        rclpy.try_shutdown()
    return ExitCode.INTERRUPTED if signal.SIGINT in received else ExitCode.DONE
