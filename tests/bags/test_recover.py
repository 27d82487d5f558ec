# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip recover``: a complete bag of the remains of a damaged one, and a report of the loss."""

import hashlib
import random
import resource
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zstandard
from fixtures.made_bags import IMU, MS, TEXT, damage_chunk, imu, write_foreign, write_imu
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from trackslip_bags.qos import offered_qos
from trackslip_bags.reader import open_bag
from trackslip_bags.recovery.recover import recover
from trackslip_bags.writer import BagWriter
from trackslip_common.errors import ExitCode, InputError
from trackslip_tools.cli.main import main

COUNT = 400
LATCHED = offered_qos(latched=True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of 4 s of IMU at 100 Hz in eight chunks, published before they are logged; and a silent topic."""
    path = tmp_path_factory.mktemp("recover") / "bag"
    with BagWriter(path) as bag:
        bag.add_topic("/imu", IMU, LATCHED)
        bag.add_topic("/silent", TEXT)
        for i in range(COUNT):
            bag.write("/imu", IMU, imu(i * 10 * MS), i * 10 * MS, i * 9 * MS)
    return path


@pytest.fixture
def damaged(whole: Path, tmp_path: Path) -> Path:
    """A copy of the bag, to be damaged."""
    return Path(shutil.copytree(whole, tmp_path / "bag"))


def cut(path: Path, share: float) -> None:
    """Keep a share of a recording without metadata, as after a power cut."""
    file = path / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: int(file.stat().st_size * share)])
    (path / "metadata.yaml").unlink()


def contents(path: Path) -> list[bytes]:
    """The IMU messages of a complete bag, by two readers that check it."""
    with open_bag(path) as bag:
        assert bag.damage == ""
        ours = [m.raw for m in bag.messages(["/imu"])]
    theirs = []
    for file in sorted(path.glob("*.mcap")):
        with file.open("rb") as stream:
            theirs += [m.data for _, _, m in make_reader(stream, validate_crcs=True).iter_messages(["/imu"])]
    assert theirs == ours
    return ours


@pytest.mark.parametrize("share", [0.12, 0.5, 0.99])
def test_cut_bag_is_recovered_up_to_its_last_whole_chunk(
    damaged: Path, tmp_path: Path, share: float, capsys: pytest.CaptureFixture[str]
) -> None:
    cut(damaged, share)
    before = hashlib.sha256((damaged / "bag_0.mcap").read_bytes()).digest()
    assert main(["recover", str(damaged)]) == ExitCode.DONE
    printed = capsys.readouterr().out
    assert "bag_0.mcap: cut short\n" in printed
    assert "lost: what a killed recorder had not written yet, at most 0.5 s" in printed
    recovered = contents(tmp_path / "bag_recovered")
    assert len(recovered) % 50 == 0
    assert len(recovered) >= (share - 0.3) * COUNT
    assert recovered == [imu(i * 10 * MS) for i in range(len(recovered))]
    assert hashlib.sha256((damaged / "bag_0.mcap").read_bytes()).digest() == before
    assert [file.name for file in damaged.iterdir()] == ["bag_0.mcap"]


def test_topics_types_times_and_quality_of_service_come_along(damaged: Path, tmp_path: Path) -> None:
    cut(damaged, 0.9)
    recover(damaged, tmp_path / "out")
    with (tmp_path / "out" / "out_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        times = [(m.log_time, m.publish_time) for _, _, m in reader.iter_messages()]
        summary = reader.get_summary()
    assert times[:3] == [(0, 0), (10 * MS, 9 * MS), (20 * MS, 18 * MS)]
    assert summary is not None
    channels = {channel.topic: channel for channel in summary.channels.values()}
    assert channels.keys() == {"/imu", "/silent"}
    assert channels["/imu"].metadata["offered_qos_profiles"] == LATCHED
    assert channels["/imu"].metadata["topic_type_hash"].startswith("RIHS01_")


@pytest.mark.parametrize("number", [0, 3])
def test_damaged_chunk_loses_only_its_own_messages(
    damaged: Path, tmp_path: Path, number: int, capsys: pytest.CaptureFixture[str]
) -> None:
    damage_chunk(damaged / "bag_0.mcap", number)
    assert main(["recover", str(damaged), "--output", str(tmp_path / "out")]) == ExitCode.DONE
    printed = capsys.readouterr().out
    assert "bag_0.mcap: 1 damaged chunks\n" in printed
    assert "lost: 50 of 400 messages\n" in printed
    assert contents(tmp_path / "out") == [imu(i * 10 * MS) for i in range(COUNT) if i // 50 != number]


def test_a_split_bag_keeps_its_files(tmp_path: Path) -> None:
    write_imu(tmp_path / "bag", COUNT, split_duration=1.0)
    last = tmp_path / "bag" / "bag_3.mcap"
    last.write_bytes(last.read_bytes()[: last.stat().st_size // 2])
    (tmp_path / "bag" / "metadata.yaml").unlink()
    shares: list[float] = []
    recovery = recover(tmp_path / "bag", tmp_path / "out", shares.append)
    assert len(shares) > 4  # several per file
    assert sum(shares) == pytest.approx(1.0)
    assert (recovery.truncated_files, len(recovery.problems)) == (1, 1)
    assert len(list((tmp_path / "out").glob("*.mcap"))) == 4
    recovered = contents(tmp_path / "out")
    assert recovered == [imu(i * 10 * MS) for i in range(len(recovered))]
    assert 300 <= len(recovered) < 400


def test_a_whole_bag_loses_nothing(whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["recover", str(whole), "--output", str(tmp_path / "out")]) == ExitCode.DONE
    assert capsys.readouterr().out.startswith("nothing was lost\n")
    assert contents(tmp_path / "out") == contents(whole)


def test_zeros_after_the_end_of_a_file_are_not_read_into_memory(damaged: Path) -> None:
    """The file is sparse: 8 GiB of zeros follow its end."""
    file = damaged / "bag_0.mcap"
    with file.open("r+b") as stream:
        stream.truncate(file.stat().st_size + 2**33)
    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (2**32, before[1]))
    try:
        assert main(["recover", str(file)]) == ExitCode.DONE
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
    assert len(contents(damaged / "bag_0_recovered")) == COUNT


def test_a_recorder_killed_before_its_first_chunk_leaves_an_empty_bag(tmp_path: Path) -> None:
    killed = BagWriter(tmp_path / "bag")
    killed.write("/imu", IMU, imu(0), 0)
    killed.abandon()
    shutil.copytree(tmp_path / "bag", tmp_path / "copy")
    file = tmp_path / "copy" / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:30])
    recovery = recover(tmp_path / "copy", tmp_path / "out")
    assert (recovery.messages, recovery.truncated_files) == (0, 1)
    assert contents(tmp_path / "out") == []


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.MESSAGE, CompressionMode.FILE])
@pytest.mark.parametrize("with_metadata", [True, False])
def test_bags_of_ros2_bag_are_read_and_recovered(
    tmp_path: Path, storage: StoragePlugin, mode: CompressionMode, with_metadata: bool
) -> None:
    """A recorder that was killed records nowhere that messages or files are compressed."""
    sent = [imu(k * 10 * MS) for k in range(20)]
    write_foreign(tmp_path / "bag", (("/imu", IMU, k, raw) for k, raw in enumerate(sent)), storage, mode)
    if not with_metadata:
        (tmp_path / "bag" / "metadata.yaml").unlink()
    paths = [tmp_path / "bag"]
    if mode is not CompressionMode.FILE or not with_metadata:
        paths += [file for file in paths[0].iterdir() if file.suffix != ".yaml"]
    for path in paths:
        with open_bag(path) as opened:
            assert [message.raw for message in opened.messages()] == sent
    assert recover(tmp_path / "bag", tmp_path / "out").messages == 20
    assert contents(tmp_path / "out") == sent


def test_compressed_files_before_a_cut_one_are_recovered(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    content = next(whole.glob("*.mcap")).read_bytes()
    (tmp_path / "bag" / "bag_0.mcap.zstd").write_bytes(zstandard.ZstdCompressor().compress(content))
    (tmp_path / "bag" / "bag_1.mcap").write_bytes(content[: len(content) // 2])
    recovery = recover(tmp_path / "bag", tmp_path / "out")
    assert COUNT < recovery.messages < 2 * COUNT
    assert any("bag_1.mcap: cut short" in problem for problem in recovery.problems)


def test_message_that_is_not_cdr_is_dropped_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_foreign(tmp_path / "bag", [("/imu", IMU, 0, b"no CDR")])
    (tmp_path / "bag" / "metadata.yaml").unlink()
    assert main(["recover", str(tmp_path / "bag"), "--output", str(tmp_path / "out")]) == ExitCode.FAILED
    assert "lost: 1 messages that are not CDR" in capsys.readouterr().out
    assert contents(tmp_path / "out") == []


def test_topics_of_unknown_types_are_kept(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with (tmp_path / "bag" / "bag_0.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2", library="another")
        schema = writer.register_schema("strange_msgs/msg/Strange", "ros2msg", b"uint8 value\n")
        channel = writer.register_channel("/strange", "cdr", schema)
        writer.add_message(channel, 5, b"\0\1\0\0\x07", 5)
        writer.flush()
    recover(tmp_path / "bag", tmp_path / "out")
    with open_bag(tmp_path / "out") as bag:
        (message,) = bag.messages()
        assert bag.deserialize(message.raw, message.type_name).value == 7


def test_nothing_is_overwritten(whole: Path, tmp_path: Path, refuse: Callable[..., str]) -> None:
    (tmp_path / "out").mkdir()
    assert "exists already" in refuse("recover", whole, "--output", tmp_path / "out")
    assert "exists already" in refuse("recover", whole, "--output", whole)
    assert list((tmp_path / "out").iterdir()) == []
    assert len(contents(whole)) == COUNT


def test_a_missing_bag_is_refused(tmp_path: Path, refuse: Callable[..., str]) -> None:
    path = tmp_path / "bag.mcap"
    error = refuse("recover", path)
    assert str(path) in error
    assert "accepted: a rosbag2 directory" in error
    assert not (tmp_path / "bag_recovered").exists()


def test_a_full_disk_leaves_no_half_recovery(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = BagWriter.write

    def until_full(self: BagWriter, *arguments: Any) -> None:
        if self.counts["/imu"] == 100:
            raise OSError(28, "No space left on device")
        write(self, *arguments)

    monkeypatch.setattr(BagWriter, "write", until_full)
    with pytest.raises(InputError, match="out' cannot be written"):
        recover(whole, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("seed", range(16))
def test_random_damage_never_makes_a_bad_bag(whole: Path, tmp_path: Path, seed: int) -> None:
    """Truncated, overwritten, doubled or partly removed: all recovered messages were in the bag, in order."""
    random_ = random.Random(seed)
    data = bytearray((whole / "bag_0.mcap").read_bytes())
    for _ in range(random_.randint(1, 4)):
        at, length = random_.randrange(20, len(data)), random_.randint(1, 200)
        kind = random_.choice(("cut", "overwrite", "remove", "double"))
        if kind == "cut":
            del data[at:]
        elif kind == "overwrite":
            data[at : at + length] = random_.randbytes(length)
        elif kind == "remove":
            del data[at : at + length]
        else:
            data[at:at] = data[at : at + length]
    (tmp_path / "bag_0.mcap").write_bytes(bytes(data))
    recover(tmp_path / "bag_0.mcap", tmp_path / "out")
    recovered = contents(tmp_path / "out")
    sent = iter(imu(i * 10 * MS) for i in range(COUNT))
    assert all(raw in sent for raw in recovered)
