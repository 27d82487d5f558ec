# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs one node from start to a clean end: one line for bad input, no traceback on Ctrl-C."""

import gc
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import ExternalShutdownException
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from trackslip_common.errors import ExitCode, InputError
from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.failures import describe_exception
from trackslip_common.start import collect_garbage_seldom

try:
    from rclpy.experimental import EventsExecutor as Executor  # half the load and latency of the one below
except ModuleNotFoundError:  # Jazzy before rclpy 7.1.4
    from rclpy.executors import SingleThreadedExecutor as Executor

__all__ = ["Executor", "run"]

_POLL = 0.1  # s, longest delay before a signal is noticed
_DRAIN_POLL = 0.02  # s
_GARBAGE_THRESHOLD = 50_000  # objects between collections of garbage, each a pause of some ms
_SECURITY = (
    "with ROS_SECURITY_ENABLE, a keystore with an enclave of this node, and a middleware with security"
    " (docs/security.md)"
)
_ARGUMENTS = "--ros-args with -p name:=value, --params-file <YAML file>, -r from:=to"


class _StopSignals:
    """SIGINT, SIGTERM, and SIGHUP unless ``nohup`` ignores it.

    During the start the first one interrupts; later ones are only recorded.
    """

    def __init__(self) -> None:
        self.received: list[int] = []
        self.interrupts = True
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, _frame: object) -> None:
        self.received.append(number)
        if self.interrupts:
            self.interrupts = False  # so that nothing interrupts the shutdown
            raise KeyboardInterrupt


def run(
    make_node: Callable[[], TrackslipNode[Any]],
    argv: Sequence[str] | None = None,
    make_executor: Callable[[], Any] = Executor,
    niceness: int = 0,
    interrupt_code: ExitCode = ExitCode.DONE,
) -> int:
    """Spin the node until SIGINT, SIGTERM or a hangup of its terminal; returns the exit code.

    ``interrupt_code``: code after SIGINT, a node's regular end unless it has something to finish.
    ``niceness``: for a node that is not used for control; with few cores the others then run first.
    """
    # with Python's threshold, a working node collects every second
    collect_garbage_seldom(_GARBAGE_THRESHOLD)
    os.nice(niceness)  # before the middleware starts its threads, which inherit it
    signals = _StopSignals()
    node: TrackslipNode[Any] | None = None
    try:
        node = _make_node(make_node, argv)
        node.send_failures.count_lost_responses()
        node.start()
        _tune_process(node)
        signals.interrupts = False
        executor = make_executor()
        executor.add_node(node)
        _spin(node, executor, signals)
        node.drain(lambda: _spin_for(node, executor, _DRAIN_POLL))
        if node.callback_failures.has_long_streak:
            print(f"{node.get_name()}: only failures; {node.callback_failures.last}", file=sys.stderr)
            return ExitCode.FAILED
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception as error:  # noqa: BLE001 (a defect of ours, but no traceback reaches a user)
        if signals.received:
            pass  # the signal caused the failure, as in a compiler that lost the exception
        elif isinstance(error, InputError):
            print(error, file=sys.stderr)
            return ExitCode.BAD_INPUT
        else:
            print(f"failed: {describe_exception(error)}", file=sys.stderr)
            return ExitCode.FAILED
    finally:
        signals.interrupts = False
        if node is not None:
            node.end()
            node.destroy_node()
        rclpy.try_shutdown()
    if node is not None and node.has_failed:
        return ExitCode.FAILED
    return interrupt_code if signal.SIGINT in signals.received else ExitCode.DONE


def _spin(node: TrackslipNode[Any], executor: Any, signals: _StopSignals) -> None:
    """Spin until a signal, the end of ROS, or a streak of failures."""
    while not signals.received and rclpy.ok() and not node.callback_failures.has_long_streak:
        _spin_for(node, executor, _POLL)


def _spin_for(node: TrackslipNode[Any], executor: Any, seconds: float) -> None:
    """Run callbacks for a time; a return to Python after each message would add a fifth to its cost.

    A failure outside of callbacks, such as a message that cannot be decoded, is counted as one of a callback.
    """
    try:
        executor.spin_until_future_complete(Future(), seconds)
    except ExternalShutdownException:
        raise
    except Exception as error:  # noqa: BLE001 (counted, and the node goes on)
        node.callback_failures.add("executor", error)


def _tune_process(node: TrackslipNode[Any]) -> None:
    """After the start: set the requested priority, and exempt all present objects from garbage collection."""
    if not _request_priority(node.common.realtime_priority):
        node.get_logger().info("real-time scheduling is not permitted: expect delays on a busy host")
    gc.freeze()  # objects of the imports stay: to search them for garbage would take tens of ms


def _request_priority(priority: int) -> bool:
    """Set real-time scheduling for all present threads, and those that they start; False if not allowed.

    Called once the node has started: compilation is not urgent.
    """
    if priority == 0:
        return True
    try:
        for thread in Path("/proc/self/task").iterdir():
            with suppress(ProcessLookupError):  # the thread has ended
                os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True


def _make_node(make_node: Callable[[], TrackslipNode[Any]], argv: Sequence[str] | None) -> TrackslipNode[Any]:
    """Initialise rclpy, and make the node."""
    set_logger_level("rcl", LoggingSeverity.FATAL)  # rcl would repeat the error on its own line
    warnings.simplefilter("ignore", RuntimeWarning)  # of rcl, when it abandons an incomplete node
    try:
        rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
        return make_node()
    except (RuntimeError, InvalidParameterTypeException) as error:
        reason = re.split(r",? at \S+:\d+", " ".join(str(error).split()))[0]
        is_secure = os.environ.get("ROS_SECURITY_ENABLE", "").lower() == "true"
        raise InputError(f"{reason}; accepted: {_SECURITY if is_secure else _ARGUMENTS}") from error
