# SPDX-License-Identifier: Apache-2.0
"""``can_driver``: sprocket encoders and hydraulics from the CAN bus."""

import sys

from trackslip_common.config_files import config_file
from trackslip_common.errors import InputError
from trackslip_common.nodes.health import Health
from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.run import run
from trackslip_drivers import conversions
from trackslip_drivers.can_parameters import CanDriverParameters
from trackslip_drivers.nodes.driver import DriverNode
from trackslip_drivers.protocols.can_errors import BusState, bus_state
from trackslip_drivers.protocols.can_frames import ERROR_FLAG, FrameSet
from trackslip_drivers.protocols.excavator_can import ExcavatorCan
from trackslip_drivers.records import SprocketSample
from trackslip_drivers.transports.can_bus import CanBus, CanFrame

_FRAME_ID = "base_link"


class CanDriverNode(DriverNode[CanDriverParameters]):
    """Frames in, ``sprockets`` and ``hydraulics`` out."""

    period = 0.01
    silence = 2.0
    realtime_priority = 10  # a message takes 0.5 ms; odometry, for which others wait, begins here

    def __init__(self) -> None:
        super().__init__("can_driver", CanDriverParameters, "can_driver.yaml")

    def configure(self) -> None:
        """Read the contract of the frames.

        Raises:
            InputError: there is none in ``dbc_file``.
        """
        super().configure()
        try:
            self._frames = FrameSet(config_file(self.settings.dbc_file))
        except InputError as error:
            raise InputError(f"can_driver: dbc_file: {error}") from error
        self._sprockets = self.advertise(topic_class("sprockets"), "sprockets")
        self._hydraulics = self.advertise(topic_class("hydraulics"), "hydraulics")
        self._joints = conversions.blank_joint_state(make, _FRAME_ID)
        self._pressures = conversions.blank_track_hydraulics(make, _FRAME_ID)
        self._bus_state = BusState.ACTIVE
        self.begin()

    def open_port(self) -> CanBus:
        """The bus."""
        return CanBus(self.settings.can_interface, self.settings.can_channel, self.settings.can_port)

    def begin(self) -> None:
        """What came before the bus was opened is not continued."""
        self._can = ExcavatorCan(self.settings, self._frames, self.tally)

    def receive(self, data: CanFrame, arrival_ns: int) -> None:
        """One frame."""
        if data[0] & ERROR_FLAG:
            self._bus_state = bus_state(*data) or self._bus_state
        elif self._bus_state is BusState.OFF:
            self._bus_state = BusState.ACTIVE  # it was restarted, without an error frame
        sample = self._can.receive(*data, self.arrived(arrival_ns))
        if isinstance(sample, SprocketSample):
            self._sprockets.publish(conversions.fill_joint_state(self._joints, self.stamped(sample)))
            self.count()
        elif sample is not None:
            filled = conversions.fill_track_hydraulics(self._pressures, self.stamped(sample))
            self._hydraulics.publish(filled)

    def health(self) -> list[Health]:
        """The link's health, with the state of the bus."""
        entries = super().health()
        if self.active:
            entries[0].values["bus state"] = self._bus_state.value
        return entries


def main() -> None:
    """Entry point."""
    sys.exit(run(CanDriverNode))
