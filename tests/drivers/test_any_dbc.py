# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""DBC files of other makers: which parts are read, and which files are refused."""

import math
import re

import cantools
import pytest
import yaml
from fixtures import unseen_bus
from fixtures.excavator_bus import PARAMETERS
from fixtures.unseen_bus import drive, machine, refusal, sprockets_of

from trackslip_common.config_files import config_file
from trackslip_common.errors import InputError
from trackslip_drivers.protocols.can_frames import STANDARD_FLAG, FrameSet
from trackslip_drivers.records import SprocketSample

S = 1_000_000_000


UNUSED = {  # according to the roles
    "29-bit id without its flag": 'BO_ 419349237 Body: 8 MC\n SG_ Door : 0|1@1+ (1,0) [0|1] "" ECU\n',
    "two multiplexers at a place": 'BO_ 1029 X: 8 MC\n SG_ A m0 : 0|8@1+ (1,0) [0|0] "" ECU\n'
    "SG_MUL_VAL_ 1029 A Gone 0-0;\n",
    "choices of no signal": 'VAL_ 387 Gone 1 "on" 0 "off" ;\n',
    "choices of no frame": 'VAL_ 999 Gone 1 "on" 0 "off" ;\n',
    "a comment on no signal": 'CM_ SG_ 387 Gone "\nBO_ 5 Five: 8 X\n";\n',
    "signals that overlap": 'BO_ 1026 Washer: 2 MC\n SG_ Level : 0|12@1+ (1,0) [0|0] "" ECU\n'
    ' SG_ Heater : 8|8@1+ (1,0) [0|0] "" ECU\n',
    "a signal longer than its frame": 'BO_ 1027 Lights: 1 MC\n SG_ Beacon : 4|8@1+ (1,0) [0|0] "" ECU\n',
}


@pytest.mark.parametrize("text", UNUSED.values(), ids=UNUSED)
def test_unreadable_frames_without_a_role_are_skipped(tmp_path, text):
    assert len(sprockets_of(machine(tmp_path, dbc=unseen_bus.DBC + text))) == 50


def test_a_role_in_a_frame_that_cannot_be_read_names_the_frame(tmp_path):
    dbc = unseen_bus.DBC + UNUSED["29-bit id without its flag"]
    text = refusal(tmp_path, "{signal: Upper.Swing, offset: 90.0, sign: -1}", "Body.Door", dbc)
    assert re.search("frame 'Body' there: .*more than 11 bits", text)


@pytest.mark.parametrize("zeros", ["[0.0|0.0]", "[0|0]", "[0E0|-0.0]"])
def test_range_of_zeros_means_no_range(tmp_path, zeros):
    assert "[-300|300]" in unseen_bus.DBC
    driver = machine(tmp_path, dbc=unseen_bus.DBC.replace("[-300|300]", zeros))
    assert len(sprockets_of(driver)) == 50
    assert "TravelFlow" not in driver.tally.by_source()


@pytest.mark.parametrize("pump", [f"{10**307},0", "1E308,1E308"], ids=str.__len__)
def test_value_beyond_the_range_of_a_double_is_never_infinite(tmp_path, pump):
    assert "(0.2,0) [0|50]" in unseen_bus.DBC
    driver = machine(tmp_path, dbc=unseen_bus.DBC.replace("(0.2,0) [0|50]", f"({pump}) [0|0]"))
    samples = drive(driver, unseen_bus.frames(S, 2 * S))
    assert not any(math.isinf(value) for one in samples for value in one if isinstance(value, float))
    assert len([one for one in samples if isinstance(one, SprocketSample)]) == 50


@pytest.mark.parametrize("factor", ["0", "361", str(10**307), "1E308"], ids=str.__len__)
def test_a_position_in_steps_of_zero_or_of_more_than_a_turn_is_refused(tmp_path, factor):
    dbc = unseen_bus.DBC.replace("(0.1,0) [0|359.9]", f"({factor},0) [0|0]")
    reason = "a step of more than a turn" if factor != "0" else "signal 'Upper.Swing' has the factor 0 in"
    assert reason in refusal(tmp_path, "roles", "roles", dbc)


def test_a_signal_of_a_role_has_64_bits_at_most(tmp_path):
    """A DBC with a signal of more bits is refused."""
    signal = re.search(r"SG_ (\w+) : (\d+)\|(\d+)@(\S+) \(0.1,0\) \[0\|359.9\]", unseen_bus.DBC)
    assert signal is not None
    wide = signal[0].replace(f"{signal[2]}|{signal[3]}@{signal[4][0]}", "0|1100@1")
    dbc = re.sub(r"(BO_ \d+ \w+: )\d+", r"\g<1>200", unseen_bus.DBC).replace(signal[0], wide)
    assert "64" in refusal(tmp_path, "roles", "roles", dbc)


@pytest.mark.parametrize("padding", [b"\0" * 4, b"\xff"])
def test_frames_longer_than_the_dbc_are_read_unless_unused_bits_are_zero(tmp_path, padding):
    sent = [(s, i, d + padding if len(d) == 4 else d) for s, i, d in unseen_bus.frames(S, 2 * S)]
    driver = machine(tmp_path)
    assert len(sprockets_of(driver, sent)) == 50
    strict = machine(tmp_path, unseen_bus.ROLES + "frames: {TravelFlow: {unused_bits_zero: true}}\n")
    assert not sprockets_of(strict, sent)
    assert strict.tally.by_source()["TravelFlow"] == {"wrong length": 50}


def test_frames_with_unused_bits_are_rejected_where_these_are_zero(tmp_path):
    driver = machine(tmp_path, unseen_bus.ROLES + "frames: {Upper: {unused_bits_zero: true}}\n")
    for change, rejected in ((b"\0", {}), (b"\1", {"unused bits are set": 20})):
        sent = unseen_bus.frames(S, 2 * S)
        drive(driver, [(s, i, d[:-1] + change if i == 387 | STANDARD_FLAG else d) for s, i, d in sent])
        assert driver.tally.by_source().get("Upper", {}) == rejected


def of_j1939(dbc):
    """The DBC with the flows as a parameter group of J1939; its source address FE stands for any address."""
    return dbc.replace("BO_ 385", f"BO_ {0x98FF0AFE}")


def from_source(address):
    for stamp_ns, name, data in unseen_bus.frames(S, 2 * S):
        yield stamp_ns, 0x18FF0A00 | address if len(data) == 4 else name, data


def test_another_source_address_is_named_and_j1939_accepts_it(tmp_path):
    driver = machine(tmp_path, dbc=of_j1939(unseen_bus.DBC))
    assert not sprockets_of(driver, from_source(0x27))
    assert all(
        word in driver.decoder.no_role_message() for word in ("TravelFlow", "0x27", "0xFE", "j1939: true")
    )
    roles = unseen_bus.ROLES + "frames: {TravelFlow: {j1939: true}}\n"
    accepting = machine(tmp_path, roles, of_j1939(unseen_bus.DBC))
    assert len(sprockets_of(accepting, from_source(0x27))) == 50
    assert accepting.decoder.other_id_message() == ""


def test_ids_of_a_bus_without_roles_are_named(tmp_path):
    driver = machine(tmp_path)
    drive(driver, [(s, 0x321 | STANDARD_FLAG, d) for s, _, d in unseen_bus.frames(S, 2 * S)])
    assert "0x321" in driver.decoder.no_role_message()


PILOTS = """BO_ 1040 Pilots: 4 MC
 SG_ LF : 0|8@1+ (0.02,0) [0|5] "MPa" ECU
 SG_ LB : 8|8@1+ (0.02,0) [0|5] "MPa" ECU
 SG_ RF : 16|8@1+ (0.02,0) [0|5] "MPa" ECU
 SG_ RB : 24|8@1+ (0.02,0) [0|5] "MPa" ECU
"""
PILOT_ROLES = """roles:
  left_spool: {signal: Pilots.LF, minus: Pilots.LB, zero: 0.5 MPa, full: 30 bar}
  right_spool: {signal: RB, minus: RF, zero: 0.5, full: 3, sign: -1}
"""


@pytest.mark.parametrize(
    ("pilots", "spools"),
    [
        ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0)),
        ((3.0, 0.4, 0.4, 3.0), (1.0, -1.0)),
        ((5.0, 0.0, 0.0, 5.0), (1.0, -1.0)),
        ((0.3, 1.76, 1.76, 0.3), (-0.504, 0.504)),
    ],
)
def test_pilot_pressures_are_spools(tmp_path, pilots, spools):
    driver = machine(tmp_path, PILOT_ROLES, unseen_bus.DBC + PILOTS)
    data = bytes(round(value / 0.02) for value in pilots)
    samples = [driver.receive(1040 | STANDARD_FLAG, data, S + k * S // 50) for k in range(10)]
    assert samples[-1][0].left_spool == pytest.approx(spools[0])
    assert samples[-1][0].right_spool == pytest.approx(spools[1])


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("zero: 0.5 MPa, ", "", "zero: '' is no pressure"),
        ("full: 30 bar", "full: 30 l", "full: '30 l' is no pressure"),
        ("full: 30 bar", "full: 0.4 MPa", "is not above zero"),
        ("Pilots.LF, minus: Pilots.LB", "Upper.LeverL", "zero and full are for pilot pressures"),
    ],
)
def test_a_pilot_pressure_needs_its_ends(tmp_path, old, new, reason):
    assert reason in refusal(tmp_path, old, new, unseen_bus.DBC + PILOTS, PILOT_ROLES)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("LeverR : 39|8", "LeverR : 36|8", "signals Temperature and LeverR are overlapping"),
        ("LeverR : 39|8", "LeverR : 63|16", "signal LeverR does not fit"),
        ("Temperature : 47|8@0+", "Temperature : 60|8@1+", "signal Temperature does not fit"),
    ],
)
def test_malformed_frame_with_a_role_is_refused(tmp_path, old, new, reason):
    assert old in unseen_bus.DBC
    with pytest.raises(InputError) as caught:
        machine(tmp_path, dbc=unseen_bus.DBC.replace(old, new))
    text = str(caught.value)
    assert text.startswith(f"dbc_file {tmp_path / 'machine.dbc'}: frame 'Upper': ")
    assert reason in text
    assert "; accepted: " in text
    assert "\n" not in text


def test_two_frames_of_one_name_are_refused(tmp_path):
    other = 'BO_ 1028 Upper: 8 MC\n SG_ Fan : 0|8@1+ (1,0) [0|0] "" ECU\n'
    text = refusal(tmp_path, "roles", "roles", unseen_bus.DBC + other)
    assert text.endswith("machine.dbc: frame 'Upper' is there twice; accepted: a name for each")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_degree_sign_is_read_in_any_encoding(tmp_path, encoding):
    dbc, roles = unseen_bus.write(tmp_path, dbc=unseen_bus.DBC.replace('"deg"', '"°"'))
    dbc.write_text(dbc.read_text(encoding="utf-8").replace('"l/min"', '"m³/s"'), encoding=encoding)
    frames = FrameSet(dbc, roles, PARAMETERS.vehicle)
    assert frames.bindings.position_signals["swing"].rad_per_step == pytest.approx(-math.radians(0.1))


@pytest.mark.parametrize(
    ("signal", "unit", "low"),
    [("16@0- (0.1,0)", "deg", 0.0), ("16@0- (0.0055,0)", "°", -180.0), ("16@0- (0.001,0)", "rad", 0.0)],
    ids=["0.1 deg", "360/65536 deg, rounded", "mrad"],
)
def test_swing_without_a_range_is_continuous_over_its_wrap(tmp_path, signal, unit, low):
    """The published rate equals that of the motion at each wrap."""
    swing = f'Swing : 7|{signal} [0|0] "{unit}"'
    dbc = unseen_bus.DBC.replace('Swing : 7|16@0+ (0.1,0) [0|359.9] "deg"', swing)
    if low == 0.0:
        dbc = dbc.replace("16@0- (", "16@0+ (", 1)
    assert swing.split("|")[0] in dbc
    driver = machine(tmp_path, "roles: {swing: Upper.Swing}\n", dbc)
    message = cantools.database.load_string(dbc, "dbc").get_message_by_name("Upper")
    step, rate, samples = message.get_signal_by_name("Swing").scale, 0.7, []
    degrees = 1.0 if unit == "rad" else 180.0 / math.pi
    for k in range(300):
        t = 0.05 * k
        angle = (math.degrees(rate * t) - low) % 360.0 + low
        raw = round(math.radians(angle) * degrees / step) if step != 0.0055 else round(angle * 65536 / 360)
        data = (raw % 65536).to_bytes(2, "big") + bytes(6)
        samples += driver.receive(message.frame_id | STANDARD_FLAG, data, round((1.0 + t) * S))
    assert len(samples) == 299
    assert not driver.tally.total
    assert [sample.velocity for sample in samples[5:]] == pytest.approx([rate] * 294, abs=0.03)
    last = math.remainder(rate * 0.05 * 299, 2.0 * math.pi)
    assert math.remainder(samples[-1].position - last, 2.0 * math.pi) == pytest.approx(0.0, abs=0.01)


def test_the_example_for_pilot_pressures_binds(tmp_path):
    """The roles file fits any DBC that has its signals; the maker's own DBC is not shipped."""
    roles = config_file("can_roles_zx200.yaml")
    entries = yaml.safe_load(roles.read_text(encoding="utf-8"))["roles"]
    sections = [e if isinstance(e, dict) else {"signal": e} for e in entries.values()]
    names = [entry[key] for entry in sections for key in ("signal", "minus") if key in entry]
    units = {"flow_rate": "L/min", "pressure": "MPa", "pilot_prs": "MPa", "angle": "rad"}
    frames: dict[str, list[str]] = {}
    for name in names:
        frame, _, signal = name.rpartition(".")
        unit = next(unit for ending, unit in units.items() if signal.endswith(ending))
        signals = frames.setdefault(frame or "Pilots", [])
        signals.append(f' SG_ {signal} : {8 * len(signals)}|8@1+ (0.02,0) [0|0] "{unit}" X')
    text = "".join(
        f"BO_ {k} {name}: 8 X\n" + "\n".join(s) + "\n\n" for k, (name, s) in enumerate(frames.items(), 1)
    )
    (tmp_path / "zx200.dbc").write_text('VERSION ""\nBS_:\nBU_: X\n' + text, encoding="utf-8")
    bound = FrameSet(tmp_path / "zx200.dbc", roles, PARAMETERS.vehicle).bindings
    assert {*bound.scaled_signals, *bound.position_signals} == set(entries)
    forward, backward = bound.scaled_signals["left_spool"]
    assert forward.si_value(3.5) + backward.si_value(0.1) == pytest.approx(1.0)
