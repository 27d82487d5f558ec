# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``watson_imu``: the Watson inertial unit on a serial line."""

import math
import sys
import time
from types import MappingProxyType

from trackslip_common.nodes.health import WARN, Health
from trackslip_common.nodes.messages import make
from trackslip_common.nodes.run import run
from trackslip_drivers import conversions
from trackslip_drivers.nodes.driver import PORT_REMEDY, REPORT_TIME, SerialDriverNode
from trackslip_drivers.protocols.watson import Layout, Rejection
from trackslip_drivers.protocols.watson_stream import WatsonStream
from trackslip_drivers.watson_parameters import WatsonParameters


class WatsonNode(SerialDriverNode[WatsonParameters]):
    """Receives bytes; publishes ``imu/data_raw`` and ``imu/mag``."""

    device = "Watson"
    remedies = MappingProxyType(
        {
            Rejection.WRONG_COUNT.value: "set channels, formats and full_scales to those of the unit",
            Rejection.MALFORMED.value: "set channels, formats and full_scales to those of the unit",
            Rejection.TEXT.value: f"switch the unit off and on, and {PORT_REMEDY}",
            Rejection.INVALID.value: "switch the unit off and on",
            Rejection.OVERLONG.value: PORT_REMEDY,
            Rejection.GARBLED.value: PORT_REMEDY,
        }
    )
    period = 1.0 / 11.85
    silence = 8.0  # the unit takes 5 s to start

    def __init__(self) -> None:
        super().__init__("watson_imu", WatsonParameters, "watson_imu.yaml")

    def configure(self) -> None:
        """Create decoder and publishers for the unit's channels."""
        super().configure()
        p = self.settings
        layout = Layout(p.channels, p.formats, p.full_scales)
        self._over_range = self._over_range_reported = 0
        self._over_range_s = -math.inf  # steady
        self._stream = WatsonStream(layout, p.serial_baud, round(p.time_offset * 1e9), self.tally)
        motion = conversions.blank_imu(
            make, p.frame_id, p.linear_acceleration_stddev, p.angular_velocity_stddev
        )
        field = conversions.blank_magnetic_field(make, p.frame_id, p.magnetic_field_stddev)
        self._imu = self.advertise_packed("imu/data_raw", motion)
        self._mag = self.advertise_packed("imu/mag", field)

    def health(self) -> list[Health]:
        """The link's health, and whether a motion exceeded the unit's range."""
        entries, total = super().health(), self._over_range
        entries[0].values["over range"] = total
        if total > self._over_range_reported:
            self._over_range_reported, self._over_range_s = total, time.monotonic()
        if time.monotonic() - self._over_range_s < REPORT_TIME:
            entries.append(Health(WARN, "moved or turned faster than it can measure", part="range"))
        return entries

    def restart_decoding(self) -> None:
        """Drop a half-received line."""
        self._stream.reset()

    def receive(self, data: bytes, steady_ns: int) -> None:
        """Decode received bytes, and publish."""
        for decoded in self._stream.feed(data, steady_ns):
            sample = self.restamp(decoded)
            self._over_range += sample.over_range
            conversions.fill_imu(self._imu.message, sample)
            self._imu.publish()
            if conversions.fill_magnetic_field(self._mag.message, sample) is not None:
                self._mag.publish()
            self.count_message()


def main() -> None:
    """Entry point."""
    sys.exit(run(WatsonNode))
