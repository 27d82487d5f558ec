# SPDX-License-Identifier: Apache-2.0
"""The checksum of SICK telegrams.

It shifts by one bit a byte, so it finds every error within a single byte, but not every error that
spans two: bit k of a byte and bit k+1 of the next cancel. Decoders check the structure as well.
"""

_POLYNOMIAL = 0x8005


def sick_crc(data: bytes) -> int:
    """The 16-bit checksum over everything that precedes it, STX included."""
    crc = previous = 0
    for byte in data:
        feedback = _POLYNOMIAL if crc & 0x8000 else 0
        crc = ((crc & 0x7FFF) << 1) ^ feedback ^ byte ^ (previous << 8)
        previous = byte
    return crc
