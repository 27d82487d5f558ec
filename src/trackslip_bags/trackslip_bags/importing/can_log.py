# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Logs of a CAN bus: candump, ASC, BLF, TRC by python-can, MF4 where asammdf is installed."""

import gc
import heapq
import logging
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import can
import numpy as np

from trackslip_bags.importing.bus_readers import BlfLog, open_asc
from trackslip_bags.importing.log_kinds import encoding_of_mark, kind_of
from trackslip_bags.importing.recorded_devices import CanSection
from trackslip_bags.importing.role_values import values_of
from trackslip_bags.importing.roles import ROLES
from trackslip_bags.importing.samples import Samples
from trackslip_bags.importing.times import LIMIT_NS
from trackslip_bags.sources import error_line
from trackslip_common.config_files import load_parameters
from trackslip_common.errors import InputError, joined_names
from trackslip_common.tally import Tally
from trackslip_common.units import NS_PER_S
from trackslip_common.vehicle import VehicleParameters
from trackslip_drivers.can_parameters import DEFAULT_FILES, NODE, CanDriverParameters
from trackslip_drivers.protocols.can_frames import ERROR_FLAG, FrameSet
from trackslip_drivers.protocols.excavator_can import ExcavatorCan, Sample
from trackslip_drivers.records import HydraulicsSample, SprocketSample, SwingSample
from trackslip_drivers.transports.can_bus import flagged_id

_TOPICS = {SprocketSample: "sprockets", HydraulicsSample: "hydraulics", SwingSample: "swing"}


def read_can_logs(
    paths: Sequence[Path], section: CanSection, vehicle: VehicleParameters | None
) -> tuple[list[Samples], list[str]]:
    """Samples of each topic that has roles, and notes on rejected frames.

    Raises:
        InputError: a log cannot be read, files of the section do not fit, or no frame has a role.
    """
    defaults = load_parameters(CanDriverParameters, NODE, DEFAULT_FILES)
    p = replace(defaults, vehicle=vehicle or defaults.vehicle)
    tally = Tally()
    frames = FrameSet(section.dbc, section.roles, p.vehicle)
    bus = ExcavatorCan(p, frames, tally)
    carriers: dict[str, set[str]] = {}  # frame with a role → its channels
    samples: list[Sample] = []
    notes: list[str] = []
    count = 0
    channels: set[str] = set()
    logs = [_read_frames(path, section, notes, channels) for path in paths]
    with _WarningCounter() as unread:
        for arbitration_id, data, stamp_ns, channel in heapq.merge(*logs, key=itemgetter(2)):
            count += 1
            if (codec := frames.find_codec(arbitration_id)) is not None:
                carriers.setdefault(codec.name, set()).add(channel)
            samples += bus.receive(arbitration_id, data, stamp_ns)
    names = ", ".join(path.name for path in paths)
    if unread.count:
        notes.append(f"{names}: {unread.count} line{'s' * (unread.count > 1)} cannot be read")
    for frame, of_carrier in carriers.items():
        if len(of_carrier) > 1:
            fault = f"frame '{frame}' comes on channels {joined_names(sorted(of_carrier))}"
            raise InputError(f"{section.where}: {names}: {fault}; accepted: channel: one of them")
    if ambiguous := bus.decoder.ambiguous_source_message():
        raise InputError(f"{section.where}: {names}: {ambiguous}")
    rejected = [
        f"{names}: {source}: {n} × {reason}"
        for source, reasons in tally.by_source().items()
        for reason, n in reasons.items()
    ]
    if not samples:
        reason = bus.decoder.no_role_message() or "; ".join([f"{count} frames give no sample", *rejected])
        if section.channel is not None and section.channel not in channels:
            reason = (
                f"no frame of channel '{section.channel}', but of {joined_names(sorted(channels)) or 'none'}"
            )
        raise InputError(f"{section.where}: {names}: {reason}; accepted: frames that have roles")
    notes += rejected
    by_topic = [[sample for sample in samples if type(sample) is kind] for kind in _TOPICS]
    return [_samples(topic, names) for topic in by_topic if topic], notes


class _WarningCounter(logging.Handler):
    """Counts warnings of python-can's readers; printed, they would repeat the raw bytes of a line."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.count = 0
        self._logger = logging.getLogger("can.io")

    def __enter__(self) -> "_WarningCounter":
        self._logger.addHandler(self)
        self._logger.propagate = False
        return self

    def __exit__(self, *_: object) -> None:
        self._logger.removeHandler(self)
        self._logger.propagate = True

    def emit(self, record: logging.LogRecord) -> None:
        """Count a warning."""
        self.count += 1


def _read_frames(
    path: Path, section: CanSection, notes: list[str], channels: set[str]
) -> Iterator[tuple[int, bytes, int, str]]:
    """(id with its flags, payload, ns, channel) of each data frame of a log; fills ``channels``."""
    _, description = kind_of(path)
    count = 0
    try:
        with _open(path, description, notes) as log:
            for message in log:
                channels.add(str(message.channel))
                if section.channel is not None and str(message.channel) != section.channel:
                    continue
                stamp_ns = round(message.timestamp * NS_PER_S) + section.offset_ns
                if not 0 <= stamp_ns < LIMIT_NS:
                    raise InputError(
                        f"{path}: a frame at {stamp_ns / NS_PER_S:.3f} s; accepted: 0 to 2^31 s (start)"
                    )
                identifier = flagged_id(message)
                if not identifier & ERROR_FLAG:
                    count += 1
                    yield identifier, bytes(message.data), stamp_ns, str(message.channel)
    except InputError:
        raise
    except Exception as error:  # damaged bytes can raise anything in the readers
        reason = error_line(error)
        if not count:
            raise InputError(f"{path}: the {description} cannot be read ({reason})") from error
        notes.append(f"{path.name}: damaged after frame {count} ({reason})")


def _open(path: Path, description: str, notes: list[str]) -> Any:
    if description.endswith("(BLF)"):
        log = BlfLog(path)
        if log.missing:
            notes.append(f"{path.name}: cut short: {log.missing} of {log.file_size} bytes are missing")
        return log
    if description.endswith("(MF4)"):
        return _open_mf4(path)
    with path.open("rb") as file:
        encoding = encoding_of_mark(file.read(4)) or "utf-8"
    text = path.open(encoding=encoding, errors="replace")  # which the reader closes
    if description.endswith("(candump)"):
        return can.CanutilsLogReader(text)
    if description.endswith("(ASC)"):
        return open_asc(text, notes, path.name)
    return can.TRCReader(text)


def _open_mf4(path: Path) -> Any:
    """A reader by asammdf, which is optional."""
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)  # its errors are raised as well
    hook = sys.unraisablehook

    def ignore_asammdf_errors(raised: Any) -> None:
        """Ignore errors of asammdf: freeing a partly opened file raises once more."""
        if not str(getattr(raised.object, "__module__", "")).startswith("asammdf"):
            hook(raised)

    sys.unraisablehook = ignore_asammdf_errors
    try:
        return can.MF4Reader(path)
    except NotImplementedError:
        reason = "MF4 needs asammdf; pip install 'asammdf>=8'"
    except Exception as error:  # noqa: BLE001 (damaged bytes can raise anything in the reader)
        reason = f"the log of a CAN bus (MF4) cannot be read ({error_line(error)})"
    finally:
        gc.collect()
        sys.unraisablehook = hook
    raise InputError(f"{path}: {reason}")


def _samples(samples: Sequence[Any], source: str) -> Samples:
    """Samples of one kind, in order of their stamps."""
    topic = _TOPICS[type(samples[0])]
    numbers = np.array([sample[1:] for sample in samples], np.float64)
    columns = dict(zip(samples[0]._fields[1:], numbers.T, strict=True))
    if topic == "swing":
        columns["angle"] = columns["position"]
    stamps_ns = np.array([sample.stamp_ns for sample in samples], np.int64)
    values = values_of(topic, columns, {}, stamps_ns)
    of_topic = Samples(topic, topic, [ROLES[topic].frame], stamps_ns, stamps_ns, values, source=source)
    return of_topic.select(np.argsort(stamps_ns, kind="stable"))
