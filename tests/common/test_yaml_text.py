# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Untrusted YAML: read, or rejected in one line, within moments."""

from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.config_files import read_yaml
from trackslip_common.errors import InputError, show
from trackslip_common.yaml_text import parse_yaml

HOSTILE = {  # large texts, beside fixtures/damaged
    "a_number_too_long_to_show": f"tread: 0x{'f' * 100_000}",
    "deep_mappings": "".join(f"{' ' * k}a:\n" for k in range(500)),
    "two_megabytes": "a: " + "x" * 2_000_000,
}


@pytest.mark.parametrize("defect", HOSTILE)
def test_hostile_yaml_is_refused_in_one_line(defect: str, tmp_path: Path) -> None:
    file = tmp_path / "hostile.yaml"
    file.write_text(HOSTILE[defect], encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_yaml(file)
    line = str(refused.value)
    assert "hostile.yaml" in line
    assert len(line) < 1000
    assert line.isprintable()


@given(st.text(alphabet="&*[]{}!:,-?|>'\"%@`#<= \n\tab019.eE+_~\x00\x1b\u2028", max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    with suppress(InputError):
        parse_yaml(text, "text")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *((text, 0.001) for text in ("1e-3", "1.0e-3", "1.e-3", "+.1E-2", "0.001")),
        *(("1.5e+6", 1.5e6), ("0x10", 16), ("-9223372036854775808", -(2**63)), ("no", False)),
        *((text, text) for text in ("1e", "e3", "1e3m", "+", "a1e3", "0x1e3g")),
    ],
)
def test_values_are_read_as_ros_reads_them(text: str, value: object) -> None:
    assert parse_yaml(f"a: {text}", "text") == {"a": value}


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("a:\n\tb: 1\n", r"tab.*line 2, column 1.*accepted: blanks"),
        ("a:\n  b: 1\n\tc: 2\n", r"tab.*line 3, column 1.*accepted: blanks"),
        ("a: 1\nb:2\nc: 3\n", r"line 2, column 1"),
    ],
)
def test_place_of_a_yaml_error_is_a_line_and_a_column(text: str, place: str) -> None:
    with pytest.raises(InputError, match=f"^file: [^<]*{place}"):
        parse_yaml(text, "file")


def test_texts_shown_have_no_control_characters(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        str(InputError('unknown "\x1b]0;title\x07" and\nmore')) == 'unknown "\\x1b]0;title\\x07" and\\nmore'
    )
    show("a\x1b[2J\nb\x07", 3)
    assert capsys.readouterr().out == "a\\x1b[2J\nb\\x07\n3\n"
