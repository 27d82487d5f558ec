# SPDX-License-Identifier: Apache-2.0
"""What the parameters state of each source."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from trackslip_common.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class PoseSource:
    """A source of poses."""

    use_heading: bool
    lever: tuple[float, float]  # m, place of the sensor in base_link
    position_floor: float  # m, smallest standard deviation that is believed
    heading_floor: float  # rad
    heading_ceiling: float  # rad, standard deviation beyond which a fix's heading is not used
    timeout_ns: int
    stamp_error: float  # s, standard deviation of a delay that all its stamps have


@dataclass(frozen=True)
class YawRateSource:
    """A gyro."""

    sign: int  # −1 where it is mounted upside down
    scale: float  # what it shows of 1 rad/s
    timeout_ns: int


def named(sources: Sequence[str]) -> list[str]:
    """The sources of a parameter list; '' names none."""
    return [source for source in sources if source]


def each(parameter: str, values: Sequence[T], sources: Sequence[str]) -> list[T]:
    """A parameter's value for each source: one holds for all.

    Raises:
        InputError: there are neither one nor as many as there are sources.
    """
    names = named(sources)
    if len(set(names)) < len(names):
        raise InputError(f"sources {', '.join(names)}: one is named twice; accepted: each once")
    if len(values) not in (1, len(names)):
        raise InputError(
            f"{parameter}: {len(values)} values for the sources '{', '.join(names)}'; "
            "accepted: one for all, or one for each"
        )
    return list(values) * len(names) if len(values) == 1 else list(values)
