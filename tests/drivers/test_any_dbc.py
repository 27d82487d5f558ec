# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The DBC of somebody else: what of it is read, and what is refused."""

import math

import cantools
import pytest
from fixtures import unseen_bus
from fixtures.excavator_bus import PARAMETERS
from fixtures.unseen_bus import drive, machine, refusal

from trackslip_common.errors import InputError
from trackslip_drivers.protocols.can_frames import STANDARD_FLAG, FrameSet
from trackslip_drivers.records import SprocketSample

S = 1_000_000_000


BROKEN = """BO_ 1026 Washer: 2 MC
 SG_ Level : 0|12@1+ (1,0) [0|0] "" ECU
 SG_ Heater : 8|8@1+ (1,0) [0|0] "" ECU
BO_ 1027 Lights: 1 MC
 SG_ Beacon : 4|8@1+ (1,0) [0|0] "" ECU
"""


def test_a_dbc_was_refused_for_a_frame_that_no_role_uses(tmp_path):
    driver = machine(tmp_path, dbc=unseen_bus.DBC + BROKEN)
    samples = drive(driver, [(s, i, d) for s, i, d in unseen_bus.frames(S, 2 * S)])
    assert len([one for one in samples if isinstance(one, SprocketSample)]) == 50


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("LeverR : 39|8", "LeverR : 36|8", "signals Temperature and LeverR are overlapping"),
        ("LeverR : 39|8", "LeverR : 63|16", "signal LeverR does not fit"),
        ("Temperature : 47|8@0+", "Temperature : 60|8@1+", "signal Temperature does not fit"),
    ],
)
def test_a_frame_with_a_role_must_be_whole(tmp_path, old, new, reason):
    assert old in unseen_bus.DBC
    with pytest.raises(InputError) as caught:
        machine(tmp_path, dbc=unseen_bus.DBC.replace(old, new))
    text = str(caught.value)
    assert text.startswith(f"dbc_file {tmp_path / 'machine.dbc'}: frame 'Upper': ")
    assert reason in text
    assert "; accepted: " in text
    assert "\n" not in text


def test_a_position_with_the_factor_0_ended_in_a_traceback(tmp_path):
    text = refusal(tmp_path, "roles", "roles", unseen_bus.DBC.replace("(0.1,0) [0|359.9]", "(0,0) [0|359.9]"))
    assert "signal 'Upper.Swing' has the factor 0 in" in text


def test_of_two_frames_of_a_name_the_wrong_one_was_read(tmp_path):
    other = 'BO_ 1028 Upper: 8 MC\n SG_ Fan : 0|8@1+ (1,0) [0|0] "" ECU\n'
    text = refusal(tmp_path, "roles", "roles", unseen_bus.DBC + other)
    assert text.endswith("machine.dbc: frame 'Upper' is there twice; accepted: a name for each")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_a_degree_sign_of_utf_8_was_unknown(tmp_path, encoding):
    dbc, roles = unseen_bus.write(tmp_path, dbc=unseen_bus.DBC.replace('"deg"', '"°"'))
    dbc.write_text(dbc.read_text(encoding="utf-8").replace('"l/min"', '"m³/s"'), encoding=encoding)
    frames = FrameSet(dbc, roles, PARAMETERS.vehicle)
    assert frames.bindings.turned["swing"].rad_per_step == pytest.approx(-math.radians(0.1))


@pytest.mark.parametrize("low", [0.0, -180.0], ids=["0 to 360", "-180 to 180"])
@pytest.mark.parametrize(
    ("signal", "unit"),
    [("16@0- (0.1,0)", "deg"), ("16@0- (0.0055,0)", "°"), ("16@0- (0.001,0)", "rad")],
    ids=["0.1 deg", "360/65536 deg, rounded", "mrad"],
)
def test_a_swing_without_a_range_went_back_a_turn_at_each_wrap(tmp_path, signal, unit, low):
    """Up to −4.5 rad/s were published."""
    swing = f'Swing : 7|{signal} [0|0] "{unit}"'
    dbc = unseen_bus.DBC.replace('Swing : 7|16@0+ (0.1,0) [0|359.9] "deg"', swing)
    if low == 0.0:
        dbc = dbc.replace("16@0- (", "16@0+ (", 1)
    assert swing.split("|")[0] in dbc
    driver = machine(tmp_path, "roles: {swing: Upper.Swing}\n", dbc)
    message = cantools.database.load_string(dbc, "dbc").get_message_by_name("Upper")
    step, rate, found = message.get_signal_by_name("Swing").scale, 0.7, []
    degrees = 1.0 if unit == "rad" else 180.0 / math.pi
    for k in range(600):
        t = 0.05 * k
        angle = (math.degrees(rate * t) - low) % 360.0 + low
        raw = round(math.radians(angle) * degrees / step) if step != 0.0055 else round(angle * 65536 / 360)
        data = (raw % 65536).to_bytes(2, "big") + bytes(6)
        found += driver.receive(message.frame_id | STANDARD_FLAG, data, round((1.0 + t) * S))
    assert len(found) == 599
    assert driver.tally.total == {("swing_encoder", "first reading"): 1}
    assert [one.velocity for one in found[5:]] == pytest.approx([rate] * 594, abs=0.03)
    last = math.remainder(rate * 0.05 * 599, 2.0 * math.pi)
    assert math.remainder(found[-1].position - last, 2.0 * math.pi) == pytest.approx(0.0, abs=0.01)
