# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A ROS domain that no other demo of this host uses: two in one would drive each other's machine."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager

from trackslip_common.errors import InputError

_FIRST, _COUNT = 1, 100  # up to 101 the ports of a domain are no client's


@contextmanager
def claimed_domain() -> Iterator[int]:
    """The one of ``ROS_DOMAIN_ID``, or a free one; until the exit.

    Raises:
        InputError: another demo runs in it, or it is no number.
    """
    stated = os.environ.get("ROS_DOMAIN_ID")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as claim:
        domain = next((domain for domain in _candidates(stated) if _is_bound(claim, domain)), None)
        if domain is None:
            where = f"in domain {stated}" if stated else "in each domain"
            raise InputError(f"ROS_DOMAIN_ID: another demo runs {where}; accepted: another one, or none set")
        yield domain


def _candidates(stated: str | None) -> list[int]:
    if stated:
        if not stated.isascii() or not stated.isdigit():
            raise InputError(f"ROS_DOMAIN_ID: '{stated}' is no domain; accepted: 0 to 101")
        return [int(stated)]
    return [_FIRST + (os.getpid() + k) % _COUNT for k in range(_COUNT)]


def _is_bound(claim: socket.socket, domain: int) -> bool:
    """Whether the name of that domain is ours now: such a name is in no file, and ends with its owner."""
    try:
        claim.bind(f"\0trackslip-demo-domain-{domain}")
    except OSError:
        return False
    return True
