# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The state file: written, read, and handled when it is damaged, foreign or cannot be replaced."""

import os
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path

import pytest
from fixtures.drawn_machine import Machine, drive, parameters
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.errors import InputError
from trackslip_common.kept_files import MAX_UNUSED_FILES
from trackslip_estimation.slip import state_file
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.learned import (
    Learned,
    LearnedContext,
    decay_to_prior,
    learned_context,
    to_tree,
)
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.state_file import StateFile, parse_state, state_text

P = parameters()
CONTEXT = learned_context(P)
NOW_S = 1.8e9
HOUR = 3600.0


def _learned(p: SlipEstimatorParameters, machine: Machine) -> Learned:
    estimator = SlipEstimator(p)
    estimator.process_all(drive(machine).measurements)
    assert estimator.learned is not None
    return estimator.learned


LEARNED = _learned(P, Machine(gyro_scale=0.97, duration=30.0))
TEXT = state_text(LEARNED, CONTEXT, NOW_S)
_OTHER_VEHICLE = parameters(**{"vehicle.kinematics.tread": 0.8})
OTHER, OF_OTHER = learned_context(_OTHER_VEHICLE), _learned(_OTHER_VEHICLE, Machine(duration=5.0))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "state" / "slip_estimator.yaml"


@pytest.fixture
def at(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """A function that sets the clock, s since 1970."""

    def set_clock(seconds: float) -> None:
        monkeypatch.setattr("time.time", lambda: seconds)

    return set_clock


def write(store: StateFile, learned: Learned | None = LEARNED, context: LearnedContext = CONTEXT) -> None:
    store.write(learned, context)
    store.finish()


def written(path: Path) -> StateFile:
    store = StateFile(str(path))
    write(store)
    return store


def of_another_vehicle(path: Path) -> StateFile:
    """The store of another vehicle, which finds the file of the first one, and writes its own."""
    store = StateFile(str(path))
    assert store.read(OTHER) is None
    assert "of another vehicle" in store.note
    write(store, OF_OTHER, OTHER)
    return store


def assert_learned(found: Learned | None, age_s: float) -> None:
    """Assert that the learned states are those of ``LEARNED`` at an age."""
    assert found is not None
    assert to_tree(found, CONTEXT) == to_tree(decay_to_prior(LEARNED, age_s, CONTEXT), CONTEXT)


def put(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")


def test_written_states_are_read_with_their_age(path: Path, at: Callable[[float], None]) -> None:
    at(NOW_S)
    assert written(path).failures == 0
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    at(NOW_S + 2 * HOUR)
    store = StateFile(str(path))
    assert_learned(store.read(CONTEXT), 2 * HOUR)
    assert store.used
    assert store.note == f"starts from values learned 2 h ago ({path})"


def test_the_file_can_be_read_by_people(path: Path) -> None:
    written(path)
    text = path.read_text(encoding="utf-8")
    assert "#   gyro reads " in text
    assert "gyro_scale: {value: -0.0" in text
    assert max(map(len, text.splitlines())) <= 120


def test_no_file_is_written_without_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    store = StateFile("")
    assert not store
    assert store.read(CONTEXT) is None
    store.write(LEARNED, CONTEXT)
    store.forget(CONTEXT)
    store.finish()
    assert store.failures == 0
    assert list(tmp_path.iterdir()) == []


def test_a_path_may_begin_at_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    store = StateFile("~/kept.yaml")
    write(store)
    assert (tmp_path / "kept.yaml").is_file()


def test_an_unknown_home_is_refused() -> None:
    with pytest.raises(InputError, match=r"state_file: '~nobody_of_this_name/kept\.yaml' has no home"):
        StateFile("~nobody_of_this_name/kept.yaml")


def test_the_first_start_has_nothing_to_read(path: Path) -> None:
    store = StateFile(str(path))
    assert store.read(CONTEXT) is None
    assert store.used
    assert store.note == f"no learned values: there is no file {path}"


@given(at=st.integers(0, len(TEXT) - 1), character=st.sampled_from("09.-ae \n#é"))
def test_a_file_changed_anywhere_is_noticed(at: int, character: str) -> None:
    changed = TEXT[:at] + character + TEXT[at + 1 :]
    if changed.strip() == TEXT.strip():
        assert parse_state(changed, CONTEXT)[1] == NOW_S
    else:
        with pytest.raises(InputError):
            parse_state(changed, CONTEXT)


@given(st.integers(0, len(TEXT.rstrip()) - 1))
def test_a_file_cut_anywhere_is_noticed(length: int) -> None:
    with pytest.raises(InputError, match="edited or truncated"):
        parse_state(TEXT[:length], CONTEXT)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "edited or truncated"),
        (b"\xff\x00\xfe" * 100, "edited or truncated"),
        (TEXT.replace("value: -0.0", "value: -0.1").encode(), "edited or truncated"),
        (b"#" * (1 << 20), "larger than 256 KiB"),
    ],
)
def test_a_file_that_does_not_fit_is_kept_aside(path: Path, content: bytes, reason: str) -> None:
    path.parent.mkdir()
    path.write_bytes(content)
    store = StateFile(str(path))
    assert store.read(CONTEXT) is None
    assert not store.used
    assert reason in store.note
    assert str(path) in store.note
    assert "\n" not in store.note
    assert path.read_bytes() == content  # until there is a state to write
    for _ in range(2):
        write(store)
    assert path.with_name(f"{path.name}.unused").read_bytes() == content
    assert len(list(path.parent.iterdir())) == 2
    assert StateFile(str(path)).read(CONTEXT) is not None


def test_up_to_nine_unusable_files_are_kept_aside(path: Path) -> None:
    """With nine of them no more files are written, and /diagnostics states the reason."""
    for n in range(MAX_UNUSED_FILES + 1):
        put(path, f"years of work, {n}")
        store = StateFile(str(path))
        assert store.read(CONTEXT) is None
        write(store)
    assert store.failure == "9 files slip_estimator.yaml.unused… are there already; move or delete some"
    assert path.read_text(encoding="utf-8") == f"years of work, {MAX_UNUSED_FILES}"
    store.forget(CONTEXT)
    assert store.failures == 2
    texts = sorted(file.read_text(encoding="utf-8") for file in path.parent.iterdir())
    assert texts == [f"years of work, {n}" for n in range(MAX_UNUSED_FILES + 1)]
    path.with_name(f"{path.name}.unused-3").unlink()
    write(store)
    assert store.failure == ""
    assert StateFile(str(path)).read(CONTEXT) is not None


def test_vehicle_finds_its_file_after_another_one_used_the_path(
    path: Path, at: Callable[[float], None]
) -> None:
    """The first vehicle's file is kept under a name of its own."""
    at(NOW_S)
    written(path)
    first = path.read_bytes()
    of_another_vehicle(path)
    (aside,) = (p for p in path.parent.iterdir() if p != path)
    assert aside.name.startswith(f"{path.name}.of-")
    assert aside.read_bytes() == first
    assert StateFile(str(path)).read(OTHER) is not None

    at(NOW_S + HOUR)
    again = StateFile(str(path))
    assert_learned(again.read(CONTEXT), HOUR)
    assert again.used
    assert "60 min ago" in again.note
    assert ".of-" in again.note
    again.forget(CONTEXT)
    assert first not in [file.read_bytes() for file in path.parent.iterdir()]
    assert StateFile(str(path)).read(CONTEXT) is None
    assert StateFile(str(path)).read(OTHER) is not None  # under its new name


def test_damaged_file_kept_aside_is_reported_and_kept(path: Path) -> None:
    """It is kept aside while the file of another machine is in its place."""
    written(path)
    of_another_vehicle(path)
    (aside,) = (p for p in path.parent.iterdir() if p != path)
    aside.write_text("years of work", encoding="utf-8")
    store = StateFile(str(path))
    assert store.read(CONTEXT) is None
    assert f"{aside} is not used: its checksum is wrong: it was edited or truncated" in store.note
    assert not store.used
    write(store)
    assert aside.with_name(f"{aside.name}.unused").read_text(encoding="utf-8") == "years of work"
    assert StateFile(str(path)).read(CONTEXT) is not None


@pytest.mark.parametrize("now_s", [NOW_S - HOUR, 0.0, NOW_S + 1e9])
def test_implausible_clock_ages_learned_states_by_a_week(
    path: Path, at: Callable[[float], None], now_s: float
) -> None:
    at(NOW_S)
    written(path)
    at(now_s)
    store = StateFile(str(path))
    assert_learned(store.read(CONTEXT), 7 * 86400.0)
    assert "at an unknown time" in store.note


def test_file_of_another_version_is_not_used() -> None:
    body = TEXT.replace("version: 2\n", "version: 99\n").rpartition("\nchecksum: ")[0]
    with pytest.raises(InputError, match="of another version"):
        parse_state(f"{body}\nchecksum: {state_file.digest(body)}\n", CONTEXT)


@pytest.mark.parametrize("when", ["", "yesterday", "2026-99-99", "9" * 30])
def test_file_without_a_date_is_not_used(when: str) -> None:
    date = datetime.fromtimestamp(NOW_S, timezone.utc).isoformat()
    body = TEXT.replace(date, when).rpartition("\nchecksum: ")[0]
    assert body != TEXT
    with pytest.raises(InputError, match="time of writing"):
        parse_state(f"{body}\nchecksum: {state_file.digest(body)}\n", CONTEXT)


def test_a_full_disk_is_counted_and_leaves_the_old_file(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = written(path)
    before = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    for _ in range(2):
        write(store)
    assert (store.failures, store.failure) == (2, "No space left on device")
    assert store.status()["not written"] == "2"
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    monkeypatch.undo()
    write(store)
    assert (store.failures, store.failure) == (2, "")


@pytest.mark.parametrize("name", ["a file/kept.yaml", "/proc/kept.yaml", "bad\0name", "folder"])
def test_estimator_continues_where_its_file_cannot_be_written(tmp_path: Path, name: str) -> None:
    (tmp_path / "a file").write_text("", encoding="utf-8")
    (tmp_path / "folder").mkdir()
    store = StateFile(str(tmp_path / name))
    assert store.read(CONTEXT) is None
    if name == "folder":
        assert "it is not a regular file" in store.note
        return
    write(store)
    assert store.failures == 1
    assert store.failure


def test_no_file_is_written_before_anything_is_learned(path: Path) -> None:
    store = StateFile(str(path))
    write(store, None)
    assert not path.exists()


def test_forget_removes_the_file_until_the_next_write(path: Path, at: Callable[[float], None]) -> None:
    at(NOW_S)
    store = written(path)
    store.forget(CONTEXT)
    store.forget(CONTEXT)
    assert not path.exists()
    assert store.failures == 0
    write(store)
    assert_learned(StateFile(str(path)).read(CONTEXT), 0.0)


def test_forget_keeps_the_file_of_another_vehicle(path: Path) -> None:
    written(path)
    first = path.read_bytes()
    store = StateFile(str(path))
    assert store.read(OTHER) is None
    store.forget(OTHER)
    (aside,) = path.parent.iterdir()
    assert aside != path
    assert aside.read_bytes() == first
