# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Address, port and allowed origins of the live page."""

import ipaddress
import socket
from dataclasses import dataclass

from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, parameter

NODE = "live"
DEFAULT_FILES = ("live.yaml",)
_BACKLOG = 4096  # connections that wait to be accepted; the kernel lets further clients try again after 1 s
_LOCAL_HOSTS = ("127.0.0.1", "localhost", "[::1]")
_ACCEPTED_ORIGINS = "accepted: what a browser has between // and the next /, such as 192.168.4.1:5006"


@dataclass(frozen=True, kw_only=True)
class LiveParameters(Parameters):
    """See ``config/live.yaml``."""

    host: str = parameter("address to listen on")
    port: int = parameter("port to listen on; 0: any free port", ge=0, le=65535)
    origins: tuple[str, ...] = parameter("HOST:PORT that browsers may request, besides the address itself")

    def allowed_hosts(self, port: int) -> frozenset[str]:
        """HOST:PORT in the requests that are answered at this port.

        Raises:
            InputError: the page listens on all addresses, and no origin is given.
        """
        named = [_add_port(origin, port) for origin in self.origins if origin]
        if _is_any_address(self.host):
            if not named:
                raise InputError(
                    f"host {self.host} is every address of this computer: name the one that browsers "
                    f"will ask for as origin; {_ACCEPTED_ORIGINS}"
                )
            return frozenset(named)
        hosts = _LOCAL_HOSTS if self.host in _LOCAL_HOSTS else (_bracket_ipv6(self.host),)
        return frozenset([*named, *(f"{name}:{port}" for name in hosts)])


def open_sockets(host: str, port: int) -> list[socket.socket]:
    """Open the listening sockets.

    Raises:
        InputError: the address is not one of this computer, or the port is taken.
    """
    from tornado.netutil import bind_sockets

    try:
        return bind_sockets(port, address=host, backlog=_BACKLOG, reuse_port=False)
    except OSError as error:
        raise InputError(
            f"the live page cannot be served at {host}, port {port} ({error.strerror}); "
            "accepted: an address of this computer and a free port (0: any)"
        ) from error


def _is_any_address(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return host == ""


def _bracket_ipv6(host: str) -> str:
    return f"[{host}]" if ":" in host and not host.startswith("[") else host


def _add_port(origin: str, port: int) -> str:
    """HOST:PORT of an origin, in lower case as browsers send it; ``port`` if it has none."""
    name = origin.strip().lower()
    if not name or any(c in name for c in "/*@ ?#"):
        raise InputError(f"origin '{origin}' is refused; {_ACCEPTED_ORIGINS}")
    has_port = ":" in name.rpartition("]")[2]
    return name if has_port else f"{name}:{port}"
