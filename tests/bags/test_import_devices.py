# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Logs of a CAN bus and of a GNSS receiver become the bags that the drivers would have recorded."""

import math
import re
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
import yaml
from fixtures import unseen_bus
from fixtures.heading_sentences import hdt
from fixtures.imports import import_logs, refusal
from pyubx2 import GET, UBXMessage

from trackslip_bags.importing.importer import Imported
from trackslip_common.errors import InputError
from trackslip_common.make import stamp_ns_of
from trackslip_drivers.protocols.can_frames import STANDARD_FLAG
from trackslip_drivers.protocols.nmea_sentences import Position, gga, gst, sentence

S = 1_000_000_000
BEGIN_NS = 1_790_000_000 * S
DAY_NS = 1_795_564_800 * S  # 2026-11-25
BEFORE_MIDNIGHT_NS = 86_400 * S - S // 2
SECTION = {"dbc": "machine.dbc", "roles": "machine_roles.yaml"}
WRITERS = {
    "drive.log": can.CanutilsLogWriter,
    "drive.asc": can.ASCWriter,
    "drive.blf": can.BLFWriter,
    "drive.trc": can.TRCWriter,
    "drive.mf4": can.MF4Writer,
}
_MF4 = pytest.mark.skipif(find_spec("asammdf") is None, reason="pip install -r requirements/mf4.txt")


def write_bus(path: Path, channel: str | int = 0) -> Path:
    """Write two seconds of a bus with present-day stamps."""
    with WRITERS[f"drive{path.suffix}"](path) as log:
        for stamp_ns, name, data in unseen_bus.frames(S, 3 * S):
            log.on_message_received(
                can.Message(
                    timestamp=(BEGIN_NS + stamp_ns) / S,
                    arbitration_id=name & ~STANDARD_FLAG,
                    is_extended_id=False,
                    data=data,
                    channel=channel,
                )
            )
    return path


def imported(folder: Path, logs: list[Path], **sections: Any) -> tuple[Imported, dict[str, list[Any]]]:
    """The importer's result, and the messages by topic."""
    unseen_bus.write(folder)
    return import_logs(folder, logs, vehicle="pc05", **sections)


@pytest.mark.parametrize(
    "name", [*sorted(WRITERS.keys() - {"drive.mf4"}), pytest.param("drive.mf4", marks=_MF4)]
)
def test_logs_of_a_bus_are_read_by_dbc_and_roles(tmp_path: Path, name: str) -> None:
    _, messages = imported(tmp_path, [write_bus(tmp_path / name)], can=SECTION)
    assert abs(len(messages["sprockets"]) - 100) <= 1
    assert len(messages["hydraulics"]) >= 38
    assert len(messages["swing"]) >= 38
    velocities = np.array([m.velocity for m in messages["sprockets"]])
    np.testing.assert_allclose(velocities, [unseen_bus.SPEEDS] * len(velocities), atol=0.01)
    steps = np.diff([stamp_ns_of(m) for m in messages["sprockets"]])
    np.testing.assert_allclose(steps, 0.02 * S, atol=0.002 * S)


def test_times_of_candump_are_kept_and_moved_by_an_offset(tmp_path: Path) -> None:
    log = write_bus(tmp_path / "drive.log")
    _, messages = imported(tmp_path, [log], can={**SECTION, "time_offset": -0.5})
    first = stamp_ns_of(messages["sprockets"][0])
    assert first == pytest.approx(BEGIN_NS + S - S // 2, abs=0.03 * S)


def test_damaged_log_is_read_up_to_the_damage(tmp_path: Path) -> None:
    log = write_bus(tmp_path / "drive.log")
    log.write_bytes(log.read_bytes() + b"(17900 can0 what\n")
    result, messages = imported(tmp_path, [log], can=SECTION)
    assert len(messages["sprockets"]) >= 99
    assert any("damaged after frame" in note for note in result.notes)


@pytest.mark.parametrize(
    ("name", "encoding"), [("drive.log", "utf-16"), ("drive.asc", "utf-16-be"), ("drive.trc", "utf-8-sig")]
)
def test_text_in_another_encoding_is_read(tmp_path: Path, name: str, encoding: str) -> None:
    log = write_bus(tmp_path / name)
    mark = "\ufeff" if encoding == "utf-16-be" else ""
    log.write_bytes((mark + log.read_text(encoding="utf-8")).encode(encoding))
    _, messages = imported(tmp_path, [log], can=SECTION)
    assert abs(len(messages["sprockets"]) - 100) <= 1


def test_logs_of_one_drive_are_read_in_order_of_their_times(tmp_path: Path) -> None:
    lines = write_bus(tmp_path / "drive.log").read_text(encoding="utf-8").splitlines(keepends=True)
    parts = {"b.log": lines[:40], "a.log": lines[40:]}
    for name, part in parts.items():
        (tmp_path / name).write_text("".join(part), encoding="utf-8")
    _, messages = imported(tmp_path, [tmp_path / "a.log", tmp_path / "b.log"], can=SECTION)
    (folder := tmp_path / "whole").mkdir()
    _, expected = imported(folder, [tmp_path / "drive.log"], can=SECTION)
    assert {name: list(map(str, of)) for name, of in messages.items()} == {
        name: list(map(str, of)) for name, of in expected.items()
    }


def test_a_blf_cut_short_is_named(tmp_path: Path) -> None:
    log = write_bus(tmp_path / "drive.blf")
    log.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    result, messages = imported(tmp_path, [log], can=SECTION)
    assert 0 < len(messages["sprockets"]) < 90
    assert any("drive.blf: cut short" in note for note in result.notes)


def test_unreadable_lines_of_a_log_are_counted_and_not_printed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    log = write_bus(tmp_path / "drive.trc")
    lines = log.read_bytes().splitlines(keepends=True)
    log.write_bytes(b"".join([*lines[:60], b"    7  70.0 DT 1 0CFF10\x1d \x1b[31m\n", *lines[60:]]))
    result, messages = imported(tmp_path, [log], can=SECTION)
    assert len(messages["sprockets"]) > 90
    assert "drive.trc: 1 line cannot be read" in result.notes
    assert "\x1b" not in "".join(capfd.readouterr()) + caplog.text


def test_an_mf4_without_its_library_names_the_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("can.io.mf4.asammdf", None)
    (tmp_path / "drive.mf4").write_bytes(b"MDF     4.10    " + bytes(200))
    unseen_bus.write(tmp_path)
    message = refusal(tmp_path, tmp_path / "drive.mf4", can=SECTION)
    assert "drive.mf4: MF4 needs asammdf; pip install " in message


@_MF4
@pytest.mark.parametrize("size", [16, 64, 200, 5000])
def test_an_mf4_cut_short_is_refused_in_one_line_or_read(tmp_path: Path, size: int) -> None:
    log = write_bus(tmp_path / "drive.mf4")
    log.write_bytes(log.read_bytes()[:size])
    unseen_bus.write(tmp_path)
    assert "drive.mf4" in refusal(tmp_path, log, can=SECTION)


def epochs(*encoders: Any, begin_ns: int = BEFORE_MIDNIGHT_NS, count: int = 20) -> bytes:
    """NMEA at 10 Hz of a drive eastward."""
    sentences = b""
    for k in range(count):
        at = Position(begin_ns + k * S // 10, 48.1, 11.6 + 1e-6 * k, 520.0, 4, 0.6, 0.01, 0.02, 90.0, 0.2)
        sentences += b"".join(encode(at) for encode in encoders)
    return sentences


def rmc_of(day: str) -> Any:
    def encode(at: Position) -> bytes:
        time = gga(at).split(b",")[1].decode()
        return sentence(f"GNRMC,{time},A,4806.0,N,01136.0,E,0.0,90.0,{day},,,R,V")

    return encode


def test_logs_of_a_receiver_are_read_over_midnight(tmp_path: Path) -> None:
    log = tmp_path / "gnss.nmea"
    days = [rmc_of("251126"), rmc_of("261126")]
    log.write_bytes(
        epochs(days[0], gga, gst, hdt, count=5)
        + epochs(days[1], gga, gst, hdt, begin_ns=86_400 * S, count=15)
    )
    result, messages = imported(tmp_path, [log], gnss={}, datum={"latitude": 48.1, "longitude": 11.6})
    expected = [DAY_NS + BEFORE_MIDNIGHT_NS + k * S // 10 for k in range(20)]
    assert [stamp_ns_of(m) for m in messages["fix"]] == expected
    assert [stamp_ns_of(m) for m in messages["heading"]] == expected
    assert messages["fix"][-1].position_covariance[0] == pytest.approx(1e-4)
    assert messages["gnss_pose"][-1].pose.pose.position.x == pytest.approx(1.043, abs=0.01)
    assert messages["heading"][0].orientation.z == pytest.approx(0.0)
    assert [stamp_ns_of(m) for m in messages["fix_velocity"]] == expected
    assert messages["fix_velocity"][0].twist.covariance[7] == pytest.approx(0.05**2)
    assert result.notes == []


def test_a_log_without_a_date_is_noted_or_has_that_of_the_mapping(tmp_path: Path) -> None:
    (tmp_path / "gnss.nmea").write_bytes(epochs(gga))
    result, messages = imported(tmp_path, [tmp_path / "gnss.nmea"], gnss=None)
    assert stamp_ns_of(messages["fix"][0]) == BEFORE_MIDNIGHT_NS
    assert any("no date" in note for note in result.notes)
    (folder := tmp_path / "dated").mkdir()
    sections = yaml.safe_load("gnss: {date: 2026-11-25, time_offset: 0.25}")
    result, messages = imported(folder, [tmp_path / "gnss.nmea"], **sections)
    assert stamp_ns_of(messages["fix"][0]) == DAY_NS + BEFORE_MIDNIGHT_NS + S // 4
    assert result.notes == []


@pytest.mark.parametrize(
    ("before", "encoding"),
    [
        (b"48.1,N,1*55\r\n", "latin-1"),
        (b"\x8f\x00\xb5\xfe" * 40, "latin-1"),
        (b"2026-11-25 12:00:00 ", "utf-16"),
    ],
)
def test_a_log_may_begin_anywhere_in_the_stream(tmp_path: Path, before: bytes, encoding: str) -> None:
    content = before.decode("latin-1") + epochs(rmc_of("251126"), gga, begin_ns=0).decode()
    (tmp_path / "gnss.txt").write_bytes(content.encode(encoding))
    _, messages = imported(tmp_path, [tmp_path / "gnss.txt"], gnss={})
    assert [stamp_ns_of(m) for m in messages["fix"]] == [DAY_NS + k * S // 10 for k in range(20)]


def test_ubx_is_read_with_its_date(tmp_path: Path) -> None:
    fields = {"fixType": 3, "gnssFixOk": 1, "carrSoln": 2, "lat": 48.1, "lon": 11.6, "hAcc": 14, "vAcc": 20}
    log = b""
    for k in range(10):
        tow = {"iTOW": 302_418_000 + 100 * k, "year": 2026, "month": 11, "day": 25}  # 12:00:00 UTC
        log += UBXMessage("NAV", "NAV-PVT", GET, **tow, **fields).serialize()
        log += UBXMessage("MON", "MON-VER", GET).serialize()
    (tmp_path / "gnss.ubx").write_bytes(log)
    _, messages = imported(tmp_path, [tmp_path / "gnss.ubx"], gnss={})
    assert stamp_ns_of(messages["fix"][0]) == DAY_NS + 43_200 * S
    assert len(messages["fix"]) == 10


LATCHED = ("/vehicle", "/slip_estimator/parameters")


def test_logs_of_several_kinds_go_together(tmp_path: Path) -> None:
    (folder := tmp_path / "logs").mkdir()
    write_bus(folder / "drive.blf")
    (folder / "gnss.nmea").write_bytes(epochs(rmc_of("211026"), gga, begin_ns=0))
    (folder / "imu.csv").write_text("t,gz\n1,0.1\n2,0.2\n", encoding="utf-8")
    (folder / "notes.md").write_text("nothing", encoding="utf-8")
    imu = {"angular_velocity_z": {"column": "gz", "unit": "rad/s"}}
    sections = {
        "can": SECTION,
        "gnss": {},
        "topics": {"imu/data_raw": imu},
        "time": {"column": "t", "unit": "s"},
    }
    result, _ = imported(tmp_path, [folder], start=1_790_000_000.0, **sections)
    counts = {topic: n for topic, n in result.counts.items() if topic not in LATCHED}
    of_bus, of_receiver = ("sprockets", "hydraulics", "swing"), ("fix", "fix_velocity", "gnss_pose")
    assert counts.keys() == {f"/{name}" for name in (*of_bus, *of_receiver, "imu/data_raw")}


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"can": {"dbc": "no.dbc", "roles": "machine_roles.yaml"}}, "can.dbc: .*no.dbc"),
        ({"can": {"dbc": "machine.dbc"}}, "can: key 'roles' is missing"),
        ({"can": SECTION}, "no log of a CAN bus .* named"),
        ({"gnss": {"date": "today"}}, "gnss.date: 'today' is not accepted"),
        ({"gnss": {"file": "*.ubx"}}, r"no log of a GNSS receiver \(NMEA, UBX\) named '\*.ubx'"),
        ({}, "key 'topics' is missing"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(tmp_path: Path, sections: Any, message: str) -> None:
    (tmp_path / "gnss.nmea").write_bytes(sentence("GPGSV,3,1,11,03,03,111,00") * 5)
    unseen_bus.write(tmp_path)
    assert re.search(message, refusal(tmp_path, tmp_path / "gnss.nmea", **sections))


def test_headings_without_positions_are_read(tmp_path: Path) -> None:
    (tmp_path / "gnss.nmea").write_bytes(
        b"".join(sentence(f"PSAT,HPR,1200{k:02d}.0,{90 - k}.0,0,0,N") for k in range(10))
    )
    _, messages = imported(tmp_path, [tmp_path / "gnss.nmea"], gnss={})
    yaws = [2.0 * math.atan2(m.orientation.z, m.orientation.w) for m in messages["heading"]]
    np.testing.assert_allclose(yaws, np.radians(np.arange(10.0)), atol=1e-9)


@pytest.mark.parametrize(
    "logged",
    [
        "{0}\r",
        "{0},1795600800.25\n",
        '{{"t": 1, "nmea": "{0}"}}\n',
        "b'{0}\\r\\n'\n",
    ],
)
def test_sentences_are_read_however_a_logger_frames_them(tmp_path: Path, logged: str) -> None:
    lines = epochs(rmc_of("251126"), gga, begin_ns=0).decode().splitlines()
    (tmp_path / "gnss.txt").write_text("".join(map(logged.format, lines)), newline="", encoding="ascii")
    result, messages = imported(tmp_path, [tmp_path / "gnss.txt"], gnss={})
    assert [stamp_ns_of(m) for m in messages["fix"]] == [DAY_NS + k * S // 10 for k in range(20)]
    assert result.notes == []


@pytest.mark.parametrize(("day", "begin"), [("060180", 5), ("220806", 86_390), ("", 86_390)])
def test_the_date_of_a_clock_that_is_not_set_does_not_count(tmp_path: Path, day: str, begin: int) -> None:
    cold = b"".join(
        sentence(f"GNRMC,{time},V,,,,,,,{day},,,N")
        for time in (
            "000005.00",
            "000006.00",
            f"{begin // 3600:02d}{begin // 60 % 60:02d}{begin % 60:02d}.00",
        )
    )
    (tmp_path / "gnss.nmea").write_bytes(cold + epochs(gga, rmc_of("251126"), begin_ns=36_000 * S))
    _, messages = imported(tmp_path, [tmp_path / "gnss.nmea"], gnss={})
    expected = [DAY_NS + 36_000 * S + k * S // 10 for k in range(20)]
    assert [stamp_ns_of(m) for m in messages["fix"]] == expected


def test_each_session_of_a_log_is_of_the_day_that_it_states(tmp_path: Path) -> None:
    parts = {"b": ("251126", 36_000), "a": ("271126", 28_800), "c": ("281126", 40_000)}
    for name, (day, begin) in parts.items():
        of_day = epochs(gga, rmc_of(day), begin_ns=begin * S, count=5)
        (tmp_path / f"{name}.nmea").write_bytes(of_day)
    result, messages = imported(tmp_path, [tmp_path / f"{name}.nmea" for name in "abc"], gnss={})
    expected = [
        DAY_NS + (days * 86_400 + begin) * S + k * S // 10
        for days, begin in ((0, 36_000), (2, 28_800), (3, 40_000))
        for k in range(5)
    ]
    assert [stamp_ns_of(m) for m in messages["fix"]] == expected
    assert result.notes == []


def test_an_epoch_that_two_logs_hold_is_used_once(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / f"{name}.nmea").write_bytes(epochs(rmc_of("251126"), gga, begin_ns=0))
    result, messages = imported(tmp_path, [tmp_path / "a.nmea", tmp_path / "b.nmea"], gnss={})
    assert len(messages["fix"]) == len(messages["fix_velocity"]) == 20
    assert any("40 × an epoch" in note for note in result.notes)


LACKING: dict[str, tuple[bytes, str]] = {  # notes
    "velocity alone": (epochs(rmc_of("251126"), begin_ns=0), "no position.*RMC.*GGA on"),
    "headings without a time": (epochs(rmc_of("251126"), gga, hdt, hdt, hdt, begin_ns=0), "40 × another"),
    "no accuracy": (epochs(gga, begin_ns=0).replace(b",0.6,", b",,"), "20 × a fix without accuracy"),
}


@pytest.mark.parametrize("case", LACKING)
def test_what_a_log_of_a_receiver_lacks_is_noted(tmp_path: Path, case: str) -> None:
    content, words = LACKING[case]
    lines = [line[1 : line.index(b"*")].decode() for line in content.splitlines()]
    (tmp_path / "gnss.nmea").write_bytes(b"".join(map(sentence, lines)))
    result, _ = imported(tmp_path, [tmp_path / "gnss.nmea"], gnss={})
    assert any(re.search(words, note) for note in result.notes)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (sentence("GNVTG,90.0,T,,M,1.0,N,1.852,K,R") * 20, "no message states a time .*VTG.*switch GGA on"),
        (UBXMessage("NAV", "NAV-POSLLH", GET, iTOW=100).serialize() * 9, "NAV-POSLLH.*NAV-PVT"),
        (sentence("GPGSV,3,1,11,03,03,111,00") * 5, "no position and no heading .*GSV"),
    ],
)
def test_a_log_without_anything_of_use_is_refused_with_its_kinds(
    tmp_path: Path, content: bytes, words: str
) -> None:
    (tmp_path / "gnss.log").write_bytes(content)
    with pytest.raises(InputError, match=words):
        imported(tmp_path, [tmp_path / "gnss.log"], gnss={})


ASC = """{head}
base hex  timestamps {kind}
internal events logged
Begin Triggerblock {date}
   0.000000 Start of measurement
{frames}End TriggerBlock
"""


@pytest.mark.parametrize(
    ("kind", "month", "begin_ns"),
    [("absolute", "Sept.", 0), ("relative", "Sep", BEGIN_NS), ("relative", "Sept.", 0)],
)
def test_times_of_asc_count_from_their_begin(tmp_path: Path, kind: str, month: str, begin_ns: int) -> None:
    date = f"Mon {month} {time.strftime('%d %H:%M:%S %Y', time.localtime(BEGIN_NS // S))}"
    sent, before_ns, frames = unseen_bus.frames(0, 2 * S), 0, ""
    for stamp_ns, name, data in sent:
        stated_ns = stamp_ns - before_ns if kind == "relative" else stamp_ns
        before_ns = stamp_ns
        frames += f"{stated_ns / S:11.6f} 1  {name & 0x7FF:X}  Rx   d {len(data)} {data.hex(' ')}\n"
    (tmp_path / "drive.asc").write_text(
        ASC.format(head=f"date {date}", kind=kind, date=date, frames=frames), encoding="utf-8"
    )
    result, messages = imported(tmp_path, [tmp_path / "drive.asc"], can=SECTION)
    steps = np.diff([stamp_ns_of(m) for m in messages["sprockets"]])
    np.testing.assert_allclose(steps, 0.02 * S, atol=0.002 * S)
    assert stamp_ns_of(messages["sprockets"][0]) == pytest.approx(begin_ns, abs=0.03 * S)
    assert any("cannot be read" in note for note in result.notes) == (begin_ns == 0)


def test_a_frame_on_two_channels_is_refused_with_both(tmp_path: Path) -> None:
    lines = write_bus(tmp_path / "drive.log", "can0").read_text(encoding="utf-8")
    (tmp_path / "drive.log").write_text(lines + lines.replace("can0", "can1"), encoding="utf-8")
    with pytest.raises(InputError, match=r"comes on channels can0, can1; accepted: channel"):
        imported(tmp_path, [tmp_path / "drive.log"], can=SECTION)
    with pytest.raises(InputError, match=r"drive\.log: no frame of channel 'can2', but of can0, can1"):
        imported(tmp_path, [tmp_path / "drive.log"], can={**SECTION, "channel": "can2"})
    _, messages = imported(tmp_path, [tmp_path / "drive.log"], can={**SECTION, "channel": "can1"})
    assert abs(len(messages["sprockets"]) - 100) <= 1


def test_a_parameter_group_of_two_senders_is_refused_with_both(tmp_path: Path) -> None:
    dbc = """VERSION ""
BU_: MC
BO_ 2566848510 Speeds: 8 MC
 SG_ L : 0|16@1+ (0.125,-4000) [0|0] "rpm" X
 SG_ R : 16|16@1+ (0.125,-4000) [0|0] "rpm" X
"""
    log = "".join(
        f"({1_790_000_000 + k / 50}) can0 18FF00{source}#A07D607CFFFFFFFF\n"
        for k in range(50)
        for source in ("21", "22")
    )
    (tmp_path / "drive.log").write_text(log, encoding="utf-8")
    (tmp_path / "j.dbc").write_text(dbc.replace("2566848510", str(0x98FF00FE)), encoding="utf-8")
    roles = {side: {"signal": f"Speeds.{side[0].upper()}"} for side in ("left_speed", "right_speed")}
    frames = {"Speeds": {"j1939": True}}
    section = {"dbc": "j.dbc", "roles": "j.yaml"}
    (tmp_path / "j.yaml").write_text(yaml.safe_dump({"roles": roles, "frames": frames}), encoding="utf-8")
    with pytest.raises(InputError, match=r"'Speeds' comes from source addresses 0x21 and 0x22; set source"):
        imported(tmp_path, [tmp_path / "drive.log"], can=section)
    one = {side: {**role, "source": 0x22} for side, role in roles.items()}
    (tmp_path / "j.yaml").write_text(yaml.safe_dump({"roles": one, "frames": frames}), encoding="utf-8")
    _, messages = imported(tmp_path, [tmp_path / "drive.log"], can=section)
    assert len(messages["sprockets"]) == 50


def test_frames_that_give_nothing_are_refused_with_the_reason(tmp_path: Path) -> None:
    lines = write_bus(tmp_path / "drive.log").read_text(encoding="utf-8").splitlines()
    short = "".join(f"{line.partition('#')[0]}#0102\n" for line in lines)
    (tmp_path / "drive.log").write_text(short, encoding="utf-8")
    with pytest.raises(InputError, match=r"TravelFlow: .* × wrong length"):
        imported(tmp_path, [tmp_path / "drive.log"], can=SECTION)
