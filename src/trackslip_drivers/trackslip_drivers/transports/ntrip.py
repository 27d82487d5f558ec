# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Corrections from an NTRIP caster: RTCM 3 messages of one mountpoint, received in their own thread.

NTRIP 2 is HTTP, by ``http.client``. A caster of version 1 answers ``ICY 200 OK``, or a list of its
mountpoints if the requested one is missing. Every fault of the caster is handled here: it is kept as text for
diagnostics, and the connection is tried again after a pause. User and password are in the request alone.
"""

import base64
import math
import os
import socket
import ssl
import stat
import string
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from http.client import (
    HTTPConnection,
    HTTPException,
    HTTPMessage,
    HTTPResponse,
    HTTPSConnection,
    IncompleteRead,
    RemoteDisconnected,
)
from pathlib import Path

from trackslip_common.errors import InputError
from trackslip_drivers.nmea_parameters import NtripParameters
from trackslip_drivers.protocols.gnss_frames import FrameSplitter, Kind

FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
STALL_S = 10.0  # without a byte, after which the connection is made again
MAX_RATE = 50_000  # B/s over a network; corrections of all satellites are 4 kB/s
_FIRST_BURST = 64_000  # bytes beyond the rate, which casters send at first
_RATE_INTERVAL_S = 2.0  # interval over which the rate is counted
_LINE_BUFFER_S = 0.4  # of the line's capacity that may be written at once
_READ_SIZE = 4096  # bytes
_LONGEST_WAIT_S = 60.0  # for a complete message while bytes come
_MAX_OTHER_BYTES = 20_000  # bytes without a complete message, which are no corrections
_LINE_BEGINS = (string.ascii_letters + "\r\n").encode()  # of a header or an empty line; RTCM 3 begins with D3
_LONGEST_FILE = 1024  # bytes
_SOURCETABLE_END = b"ENDSOURCETABLE"
_NO_MOUNTPOINT = "has no such mountpoint; check ntrip.mountpoint"
_CHECK_CREDENTIALS = "check ntrip.credentials_file"
_POSITION_CHECK_S = 0.2  # between checks for a position


@dataclass(frozen=True)
class Credentials:
    """User and password for the caster; hidden from ``repr``."""

    user: str = field(repr=False)
    password: str = field(repr=False)


def read_credentials(path: Path) -> Credentials:
    """The credentials in a file of two lines, user and password, that only its owner may read.

    Raises:
        InputError: the file is missing or invalid, or others may read it.
    """
    where = f"nmea_gnss: ntrip.credentials_file '{path}'"
    try:
        with path.expanduser().open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            if not stat.S_ISREG(mode):
                raise InputError(f"{where}: no file; accepted: two lines, user and password")
            if stat.S_IMODE(mode) & 0o077:
                raise InputError(
                    f"{where}: mode {stat.S_IMODE(mode):04o}: others may read it; accepted: 0600 (chmod 600)"
                )
            lines = [line.rstrip("\r") for line in file.read(_LONGEST_FILE).decode("utf-8").split("\n")]
    except OSError as error:
        raise InputError(f"{where}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{where}: no UTF-8; accepted: two lines, user and password") from None
    if len(lines) < 2 or not all(lines[:2]) or any(lines[2:]) or ":" in lines[0]:
        raise InputError(f"{where}: accepted: two lines, user (without ':') and password")
    return Credentials(lines[0], lines[1])


@dataclass
class CorrectionState:
    """State of the corrections, for diagnostics."""

    fault: str = "not asked yet"  # reason why none come; empty if they do
    latest_s: float = -math.inf  # time of the latest, of ``time.monotonic``
    messages: int = 0
    bytes: int = 0
    left_out: int = 0  # messages dropped because they exceeded the line's capacity
    connections: int = 0

    @property
    def age_s(self) -> float:
        """Age of the latest; infinite before the first."""
        return time.monotonic() - self.latest_s


class _Fault(Exception):
    """A fault of the caster, as text for users."""


class _RateLimiter:
    """Limits a stream that comes in bursts to the capacity of the receiver's line."""

    def __init__(self, rate: int) -> None:
        self._rate = rate  # B/s
        self._free, self._at_s = rate * _LINE_BUFFER_S, time.monotonic()
        self._counted, self._since_s, self._burst = 0, self._at_s, _FIRST_BURST

    def count_bytes(self, size: int, now_s: float) -> None:
        """Count bytes from the caster.

        Raises:
            _Fault: the caster sends more than the line carries, and not only at first.
        """
        if now_s - self._since_s > _RATE_INTERVAL_S:
            self._counted, self._since_s, self._burst = 0, now_s, 0
        self._counted += size
        if self._counted > self._burst + self._rate * _RATE_INTERVAL_S:
            raise _Fault(f"sends more than the {self._rate / 1e3:g} kB/s that the receiver's line takes")

    def reserve(self, size: int, now_s: float) -> bool:
        """Reserve capacity for a whole message, as a part of one is useless; False if there is none now."""
        free = min(self._free + (now_s - self._at_s) * self._rate, self._rate * _LINE_BUFFER_S)
        fits = size <= free
        self._free, self._at_s = free - size if fits else free, now_s
        return fits


class _Response(HTTPResponse):
    """Response of a caster, also of version 1."""

    def begin(self) -> None:
        """Read status and headers; after ``ICY 200`` the stream may come without any, or an empty line."""
        if not self._first_bytes().startswith(b"ICY 200"):
            super().begin()
            return
        self.fp.readline(_READ_SIZE)
        while self.fp.peek(1)[:1] in _LINE_BEGINS and self.fp.readline(_READ_SIZE).strip():
            pass
        self.headers = self.msg = HTTPMessage()
        self.status, self.chunked, self.length, self.will_close = 200, False, None, True

    def _read_status(self) -> tuple[str, int, str]:
        first = self._first_bytes()
        if first.startswith((b"ICY 401", b"ERROR - Bad Password")):
            raise _Fault(f"refuses user or password; {_CHECK_CREDENTIALS}")
        if first.startswith(b"SOURCETABLE"):
            return "HTTP/1.0", 404, "sourcetable"
        status: tuple[str, int, str] = super()._read_status()  # type: ignore[misc]
        return status

    def _first_bytes(self) -> bytes:
        return self.fp.peek(32)[:32] if hasattr(self.fp, "peek") else b""


class NtripClient:
    """Keeps a connection to the caster, and passes on complete messages.

    Args:
        p: the caster.
        credentials: None: no authentication.
        max_rate: capacity of the receiver's line, B/s.
        on_message: called in the client's thread with each RTCM 3 message.
        gga: the receiver's present position as a sentence, for position-dependent corrections; None: unknown.
    """

    def __init__(
        self,
        p: NtripParameters,
        credentials: Credentials | None,
        max_rate: int,
        on_message: Callable[[bytes], object],
        gga: Callable[[], bytes | None],
    ) -> None:
        self.where = f"NTRIP caster {p.host}:{p.port}, mountpoint {p.mountpoint}"
        self._p, self._credentials, self._max_rate = p, credentials, max_rate
        self._on_message, self._gga = on_message, gga
        self._lock = threading.Lock()  # guards the state and the socket
        self._state = CorrectionState()
        self._stopping = threading.Event()
        self._socket: socket.socket | None = None
        self._thread = threading.Thread(target=self._run, name="ntrip", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop, also a blocked read."""
        self._stopping.set()
        self._disconnect()

    def _disconnect(self) -> None:
        """Shut the socket down, which ends a blocked read."""
        with self._lock:
            sock = self._socket
        if sock is not None:
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)

    def state(self) -> CorrectionState:
        """The present state of the corrections."""
        with self._lock:
            return replace(self._state)

    def _run(self) -> None:
        """Connect and receive until stopped."""
        pause_s = FIRST_PAUSE_S
        while not self._stopping.is_set():
            begun_s, messages = time.monotonic(), self._state.messages
            try:
                self._receive()
            except Exception as error:  # noqa: BLE001 (whatever a library raises, the caster is what failed)
                with self._lock:
                    self._state.fault = self._fault_text(error)
            if self._state.messages > messages and time.monotonic() - begun_s > pause_s:
                pause_s = FIRST_PAUSE_S
            self._stopping.wait(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    def _receive(self) -> None:
        """Receive over one connection, until it ends."""
        position = self._wait_for_position()
        if self._stopping.is_set():
            return
        connection, response = self._make_connection(), None
        try:
            connection.connect()
            sock = connection.sock  # the connection drops it with the response
            with self._lock:
                self._socket = sock
            response = self._request_stream(connection, position)
            if position is not None:
                sock.sendall(position)
            self._forward_messages(sock, response)
        finally:
            with self._lock:
                self._socket = None
            if response is not None:
                response.close()
            connection.close()

    def _wait_for_position(self) -> bytes | None:
        """Wait for the position as a sentence for the caster; None if positions are switched off."""
        while self._p.gga_interval > 0.0 and not self._stopping.is_set():
            if (sentence := self._gga()) is not None:
                return sentence
            with self._lock:
                self._state.fault = "waiting for a fix of the receiver, as the caster requires a position"
            self._stopping.wait(_POSITION_CHECK_S)
        return None

    def _make_connection(self) -> HTTPConnection:
        p = self._p
        if p.tls:
            context = ssl.create_default_context()
            connection: HTTPConnection = HTTPSConnection(p.host, p.port, timeout=STALL_S, context=context)
        else:
            connection = HTTPConnection(p.host, p.port, timeout=STALL_S)
        connection.response_class = _Response
        with self._lock:
            self._state.connections += 1
        return connection

    def _request_stream(self, connection: HTTPConnection, position: bytes | None) -> HTTPResponse:
        headers = {"Ntrip-Version": "Ntrip/2.0", "User-Agent": "NTRIP trackslip", "Connection": "close"}
        if self._credentials is not None:
            both = f"{self._credentials.user}:{self._credentials.password}".encode()
            headers["Authorization"] = f"Basic {base64.b64encode(both).decode()}"
        if position is not None:
            headers["Ntrip-GGA"] = position.decode("ascii").strip()
        connection.request("GET", f"/{self._p.mountpoint}", headers=headers)
        response = self._read_response(connection)
        if response.status in (401, 403):
            raise _Fault(f"refuses user or password ({response.status}); {_CHECK_CREDENTIALS}")
        if response.status == 404 or response.headers.get_content_type() == "gnss/sourcetable":
            raise _Fault(_NO_MOUNTPOINT)
        if response.status != 200:
            remedy = "; check ntrip.host, ntrip.port and ntrip.tls" if response.status < 400 else ""
            raise _Fault(f"answers {response.status}{remedy}")
        if response.headers.get_content_type() == "text/html":
            raise _Fault("answers with a web page; check ntrip.host and ntrip.port")
        return response

    def _read_response(self, connection: HTTPConnection) -> HTTPResponse:
        """The response without its stream, which a caster may send byte by byte."""
        timer, began_s = threading.Timer(STALL_S, self._disconnect), time.monotonic()
        timer.start()
        try:
            return connection.getresponse()
        finally:
            timer.cancel()
            if time.monotonic() - began_s >= STALL_S:
                raise _Fault(f"does not complete its answer within {STALL_S:g} s")

    def _forward_messages(self, sock: socket.socket, response: HTTPResponse) -> None:
        splitter, limiter, other_bytes = FrameSplitter(0), _RateLimiter(self._max_rate), 0
        sent_s = message_s = time.monotonic()
        while not self._stopping.is_set():
            data = response.read1(_READ_SIZE)
            if not data:
                raise _Fault("closed the connection")
            now_s = time.monotonic()
            if _SOURCETABLE_END in data:
                raise _Fault(_NO_MOUNTPOINT)
            limiter.count_bytes(len(data), now_s)
            other_bytes += len(data)
            for frame in splitter.feed(data, time.monotonic_ns()):
                if frame.kind is Kind.RTCM:
                    other_bytes, message_s = 0, now_s
                    is_sent = limiter.reserve(len(frame.content), now_s)
                    if is_sent:
                        self._on_message(frame.content)
                    self._count_message(len(frame.content), is_sent=is_sent)
            if other_bytes > _MAX_OTHER_BYTES or now_s - message_s > _LONGEST_WAIT_S:
                raise _Fault("sends no RTCM 3; check ntrip.mountpoint")
            if 0.0 < self._p.gga_interval <= now_s - sent_s and (sentence := self._gga()) is not None:
                sock.sendall(sentence)
                sent_s = now_s

    def _count_message(self, size: int, *, is_sent: bool) -> None:
        state = self._state
        with self._lock:
            state.left_out += not is_sent
            state.messages += is_sent
            state.bytes += is_sent * size
            state.latest_s, state.fault = time.monotonic(), ""

    @staticmethod
    def _fault_text(error: Exception) -> str:
        """Text of a fault, without any data sent or received."""
        if isinstance(error, _Fault):
            return str(error)
        if isinstance(error, TimeoutError):
            return f"sends nothing for {STALL_S:g} s"
        if isinstance(error, HTTPException):
            is_closed = isinstance(error, RemoteDisconnected | IncompleteRead)
            return "closed the connection" if is_closed else "answers no HTTP"
        if isinstance(error, ssl.SSLError):
            reason = getattr(error, "verify_message", "") or error.reason
            return f"no TLS connection ({reason}); check ntrip.tls and ntrip.host"
        if isinstance(error, OSError) and error.strerror:
            return f"not connected ({error.strerror})"
        return f"not connected ({type(error).__name__})"
