# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Connect–read–back-off loop of a sensor, in its own thread.

Every failure of a sensor is handled here: the port is closed, and the error is counted and kept as text for
diagnostics. The port is then reopened, at once if it was only silent, else after a pause. The process
continues.
"""

import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from trackslip_drivers.stamping import ReadMonitor

T = TypeVar("T")

READ_TIMEOUT_S = 0.1  # longest wait of a read; limits the delay of ``stop``
FIRST_PAUSE_S = 0.1
LONGEST_PAUSE_S = 0.5  # a sensor that returns is read again within a second
_STOP_TIMEOUT_S = 0.4


class Port(Protocol[T]):
    """An open transport. After any exception from it, it is closed and opened again."""

    note: str  # deviation from the requested settings; empty: none

    def read(self) -> Iterable[tuple[T, int]]:
        """The received data, each with its arrival in ns of system time; empty after READ_TIMEOUT_S.

        The iteration may continue while more data arrive.
        """

    def write(self, data: T) -> None:
        """Send, or raise."""

    def close(self) -> None:
        """Release the device; never called twice."""


@dataclass
class LinkState:
    """State of a link, for diagnostics; times are of ``time.monotonic``, s."""

    changed_s: float  # since when it is connected or disconnected
    received_s: float  # when data were last received, or the link was created
    connected: bool = False
    has_received: bool = False  # whether data were received since the link was created
    openings: int = 0  # times the port was opened; reconnections are one less
    errors: int = 0
    last_error: str = ""
    last_error_s: float = 0.0  # system time of it, s since 1970; 0: none
    was_silent: bool = False  # the port was closed because nothing came
    note: str = ""


@dataclass(frozen=True)
class Handlers(Generic[T]):
    """Callbacks of a link, in its own thread.

    on_data: called with received data and their arrival in ns. on_open: called after each opening, before any
    data; drops half-received messages and starts a dialogue. on_silence: called after a read that found
    nothing for READ_TIMEOUT_S. Only such a read shows that no data are left: on a busy host, bytes wait in
    the kernel.
    """

    on_data: Callable[[T, int], None]
    on_open: Callable[[], None]
    on_silence: Callable[[], None] = lambda: None


class Link(Generic[T]):
    """Keeps one port open, and passes on received data.

    Args:
        name: of the thread.
        open_port: opens the port, or raises.
        handlers: the callbacks.
        silence_s: a port that is silent for longer is closed and opened again, as a half-open line reports
            no error; infinite: never.

    Attributes:
        read_monitor: detects delays of data in the port; for the link's own thread.
    """

    def __init__(
        self,
        name: str,
        open_port: Callable[[], Port[T]],
        handlers: Handlers[T],
        silence_s: float = math.inf,
    ) -> None:
        self._open_port = open_port
        self._handlers = handlers
        self._silence_s = silence_s
        self.read_monitor = ReadMonitor(time.monotonic_ns())
        self._lock = threading.Lock()  # guards the port and the state
        self._port: Port[T] | None = None
        self._state = LinkState(time.monotonic(), time.monotonic())
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the port; returns within half a second even if an opening hangs."""
        self._stopping.set()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(_STOP_TIMEOUT_S)

    def write(self, data: T) -> bool:
        """Send, from any thread; False if there is no port or it failed."""
        return self.call_with_port(lambda port: port.write(data))

    def call_with_port(self, action: Callable[[Any], None]) -> bool:
        """Call ``action`` with the open port, from any thread; False if there is none or it failed.

        A failure is counted. A port that is gone also fails in the loop, which opens it again.
        """
        with self._lock:
            port = self._port
        if port is None:
            return False
        try:
            action(port)
        except Exception as error:  # noqa: BLE001 (whatever a library raises, the sensor is what failed)
            self._note_error(error)
            return False
        return True

    def state(self) -> LinkState:
        """The present state of the link."""
        with self._lock:
            return replace(self._state)

    def _run(self) -> None:
        """Connect, read and back off until stopped."""
        pause_s = FIRST_PAUSE_S
        while not self._stopping.is_set():
            received = False
            try:
                self.read_monitor = ReadMonitor(time.monotonic_ns())
                port = self._open_port()
                try:
                    self._set_port(port)
                    self._handlers.on_open()
                    for data, arrival_ns in self._read_until_stopped(port):
                        received = self._state.has_received = True
                        self._state.received_s = time.monotonic()
                        self._handlers.on_data(data, arrival_ns)
                except Exception as error:  # noqa: BLE001 (noted before the port is closed, which takes time)
                    self._note_error(error)
                finally:
                    self._set_port(None)
                    port.close()
            except Exception as error:  # noqa: BLE001 (whatever a library raises, the sensor is what failed)
                self._note_error(error)
            if self._state.was_silent:  # reopen without a pause: data sent to a closed port are lost
                continue
            if received:  # a port that opens but never delivers keeps the longer pause
                pause_s = FIRST_PAUSE_S
            self._stopping.wait(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    def _read_until_stopped(self, port: Port[T]) -> Iterator[tuple[T, int]]:
        """Yield received data until the link is stopped."""
        received_s = time.monotonic()
        while not self._stopping.is_set():
            is_silent = True
            self.read_monitor.record_step(time.monotonic_ns())
            for arrival in port.read():
                self.read_monitor.record_step(time.monotonic_ns())
                is_silent = False
                yield arrival
                if self._stopping.is_set():
                    return
                self.read_monitor.record_step(time.monotonic_ns())
            self.read_monitor.record_empty_port()
            if not is_silent:
                received_s = time.monotonic()
                continue
            self._handlers.on_silence()
            if time.monotonic() - received_s > self._silence_s:
                raise _SilentPortError(f"nothing received for {self._silence_s:g} s")

    def _set_port(self, port: Port[T] | None) -> None:
        with self._lock:
            self._port = port
            self._state.connected, self._state.changed_s = port is not None, time.monotonic()
            if port is not None:
                self._state.openings += 1
                self._state.note = port.note

    def _note_error(self, error: Exception) -> None:
        state = self._state
        with self._lock:
            state.errors += 1
            state.last_error_s = time.time()
            state.was_silent = isinstance(error, _SilentPortError)
            state.last_error = str(error) if state.was_silent else error_text(error)


def error_text(error: Exception) -> str:
    """The system's error text, without the port names that libraries add; else type and text of the error."""
    chain: list[BaseException] = [error]
    while inner := chain[-1].__cause__ if chain[-1].__suppress_context__ else chain[-1].__context__:
        chain.append(inner)
    for cause in reversed(chain):
        if isinstance(cause, OSError) and cause.strerror:
            return " ".join(cause.strerror.split())
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


class _SilentPortError(Exception):
    """An open port delivered nothing for too long."""
