# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Each file of ``fixtures/damaged`` with each command that may receive it: one line, and no output."""

import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import pytest

from trackslip_estimation.box.track_file import TrackFile
from trackslip_estimation.slip.learned import learned_context
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.state_file import StateFile
from trackslip_tools.cli.main import main

FOLDER = Path(__file__).parents[1] / "fixtures" / "damaged"
FILES = sorted(path.name for path in FOLDER.iterdir() if path.name != "README.md")
BAG = Path(__file__).parents[2] / "bags" / "slalom_sand"
MACHINE = learned_context(load_slip_parameters())
LONGEST = 1000  # characters in a line
LARGEST = 6000  # bytes of a file

# Commands for each kind of file: BAG is a valid bag, CSV and ROS1 are valid mappings, OUT is new.
_OVER_BAGS = ("replay BAG", "smooth BAG", "calibrate BAG", "report BAG --output OUT", "tune BAG --output OUT")
_AS_A_BAG = ("info FILE", "recover FILE", "recover FILE --output OUT", "live FILE", "replay FILE --publish")
COMMANDS: Mapping[str, Sequence[str]] = MappingProxyType(
    {
        ".yaml": (
            *(f"{command} --params FILE" for command in _OVER_BAGS),
            "replay BAG --vehicle FILE",
            "tune BAG --output OUT --plan FILE",
            "report BAG --output OUT --limits FILE",
            "import LOG --output OUT --mapping FILE",
            "simulate --output OUT --scenario FILE",
            "simulate --output OUT --scenario straight --terrain FILE",
            "simulate --output OUT --scenario straight --vehicle FILE",
            "study --cache OUT --scenario FILE",
            "study --cache OUT --terrain FILE",
            "study --estimator soil --cache OUT --scenario FILE",
        ),
        ".csv": ("import FILE --output OUT --mapping CSV", "info FILE", "replay FILE", "recover FILE"),
        ".bag": ("import FILE --output OUT --mapping ROS1",),
    }
)
BAGS = (*(command.replace("BAG", "FILE") for command in _OVER_BAGS), *_AS_A_BAG)
MAPPINGS = {
    "CSV": """\
time: {column: t, unit: s}
topics:
  sprockets: {left_velocity: {column: l, unit: rad/s}, right_velocity: {column: r, unit: rad/s}}
""",
    "ROS1": """\
topics:
  sprockets: {from: /joint_states, left: [left], right: [right]}
""",
}


def lines_of_the_list() -> dict[str, str]:
    """File → its line in the list of README.md."""
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    return dict(re.findall(r"^\| `([^`]+)` \| .* \| `([^`]+)` \|$", text, flags=re.MULTILINE))


def test_the_list_names_every_file_and_all_are_small() -> None:
    assert sorted(lines_of_the_list()) == FILES
    assert max((FOLDER / name).stat().st_size for name in FILES) <= LARGEST


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder as working and home directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    for name, text in MAPPINGS.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "LOG").write_text("t,l,r\n0,1,2\n1,1,2\n", encoding="utf-8")
    return tmp_path


def commands_of(file: Path) -> Iterator[list[str]]:
    """Commands with a copy of the file as an argument."""
    kind = file.suffix
    words = {"FILE": file.name, "BAG": str(BAG)}
    for command in (*COMMANDS.get(kind, ()), *(BAGS if kind in (".mcap", ".db3", ".bag") else ())):
        yield [words.get(word, word) for word in command.split()]


@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_is_refused_in_one_line_and_nothing_is_written(
    place: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    file = Path(shutil.copy(FOLDER / name, place))
    before = sorted(place.rglob("*"))
    output = []
    for command in commands_of(file):
        code = main(command)
        error = capsys.readouterr().err
        assert (code in (1, 2), error.count("\n"), error[-1:]) == (True, 1, "\n"), (command, code, error)
        assert error[:-1].isprintable(), (command, error)
        assert len(error) < LONGEST, (command, error)
        assert name in error, (command, error)
        assert sorted(place.rglob("*")) == before, command
        assert file.read_bytes() == (FOLDER / name).read_bytes(), command
        output.append(error)
    assert any(lines_of_the_list()[name] in error for error in output), output


@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_in_the_place_of_one_that_a_node_keeps_is_not_used(place: Path, name: str) -> None:
    file = Path(shutil.copy(FOLDER / name, place))
    state, track = StateFile(str(file)), TrackFile(str(file))
    assert state.read(MACHINE) is None
    assert track.read() is None
    for note in (state.note, track.failure):
        assert name in note
        assert note.isprintable()
    assert file.read_bytes() == (FOLDER / name).read_bytes()
