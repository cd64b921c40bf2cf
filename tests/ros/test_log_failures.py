"""What becomes of a recording when its process is killed, its disk is full, its place is gone or its name is taken."""

import json
import os
import random
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from node_client import PATIENCE, Client, NodeProcess
from rosbags.rosbag2 import Reader
from small_scenes import BOX_TRIANGLES, BOX_VERTICES, handkerchief
from test_worker import Bench

from cloth_core.body import Body
from cloth_core.errors import ClothError
from cloth_sim_ros.command_line import main
from cloth_sim_ros.log_check import check_log
from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.log_repair import recover_log
from cloth_sim_ros.log_writer import FLUSH_INTERVAL, LogError, LogWriter
from cloth_sim_ros.messages import encode_string
from cloth_sim_ros.output_files import claim_path
from cloth_sim_ros.run_recorder import RunRecorder
from cloth_sim_ros.topics import DIAGNOSTICS, GARMENT, REPORT


def test_of_a_killed_node_all_but_the_last_second_is_recovered(tmp_path, capsys):
    node, client = NodeProcess(tmp_path, auto_start=True), Client()
    client.process = node
    received = {}
    client.subscribe("garment")
    client.pattern.publish(encode_string(handkerchief()))  # without a body: it falls for ever
    client.wait(lambda: client.received["garment"])
    path = Path(client.record(True).message.removeprefix("recording "))
    seen = len(client.received["garment"])
    deadline = time.monotonic() + 3.0

    def enough():
        for frame in client.received["garment"][seen:]:
            received.setdefault(frame, time.monotonic())
        old = sum(moment < time.monotonic() - 1.2 for moment in received.values())
        return time.monotonic() > deadline and old > 15

    client.wait(enough)
    node.kill()
    killed = time.monotonic()
    client.close()

    broken, good = path.read_bytes(), tmp_path / "good.mcap"
    with pytest.raises(LogError, match="it was cut off and has no end; run `cloth-sim recover` on it"):
        LogReader(path)
    assert main(["recover", str(path), "-o", str(good)]) == 0
    assert re.search(r"wrote .*good\.mcap: \d+ messages of \d+\.\d{3} s in \d+ chunks; ", capsys.readouterr().out)
    assert path.read_bytes() == broken
    with LogReader(good) as log:
        # The transport fills up messages to a multiple of four bytes.
        kept = {message.data + bytes(-len(message.data) % 4) for message in log.messages(GARMENT)}
        count = log.count(GARMENT)
        assert log.patterns() == [handkerchief()]
    expected = {frame for frame, moment in received.items() if moment < killed - 1.0}
    assert len(expected) > 10
    assert expected <= kept
    # What came out is a log like any other, and still the same simulation.
    check_log(good)
    with Reader(good) as reader:
        assert len(list(reader.messages())) == reader.message_count
    assert main(["replay", str(good), "--verify"]) == 0
    assert f"identical: {count} frames" in capsys.readouterr().out


def test_a_message_that_nothing_follows_is_written_all_the_same(tmp_path):
    assert FLUSH_INTERVAL <= 0.5
    path = tmp_path / "run.mcap"
    log = LogWriter(path)
    log.write(REPORT, 1, encode_string("{}"))
    before = path.stat().st_size
    deadline = time.monotonic() + PATIENCE
    while path.stat().st_size == before:
        assert time.monotonic() < deadline
        time.sleep(0.1)
    recover_log(path, tmp_path / "good.mcap")
    with LogReader(tmp_path / "good.mcap") as reader:
        assert reader.count(REPORT) == 1
    log.close()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A log of many small chunks."""
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cloth_sim_ros.log_writer.CHUNK_SIZE", 20_000)
        rng = np.random.default_rng(1)
        with RunRecorder(path, [handkerchief()], Body.from_arrays(BOX_VERTICES, BOX_TRIANGLES), {}) as recorder:
            for number in range(120):
                recorder.frame(number / 30, BOX_VERTICES + rng.normal(size=(8, 3)), BOX_TRIANGLES)
    return path


def messages_of(path):
    with LogReader(path) as log:
        return [(message.topic, message.log_time, message.data) for message in log.messages()]


def test_a_cut_at_any_byte_loses_only_the_chunk_that_it_goes_through(whole, tmp_path):
    content = whole.read_bytes()
    order = messages_of(whole)
    with open(whole, "rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    ends = [chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length for chunk in chunks]
    assert len(ends) > 5
    cut, good = tmp_path / "cut.mcap", tmp_path / "good.mcap"
    sizes = random.Random(1).sample(range(len(content)), 150)
    for size in [0, 7, 8, 9, *sizes, len(content) - 1, len(content), *ends, *(end - 1 for end in ends)]:
        cut.write_bytes(content[:size])
        good.unlink(missing_ok=True)
        if size < ends[0]:
            with pytest.raises(ClothError, match=r"not an MCAP file|nothing can be recovered"):
                recover_log(cut, good)
            assert os.listdir(tmp_path) == ["cut.mcap"]
            continue
        found = recover_log(cut, good)
        check_log(good)
        kept = messages_of(good)
        assert found.chunks == sum(end <= size for end in ends)
        assert found.messages == len(kept)
        assert kept == order[: len(kept)]
        assert (len(kept) == len(order)) == (size >= ends[-1])
        assert found.was_whole == (size == len(content))


def test_a_damaged_chunk_in_the_middle_is_left_out(whole, tmp_path, capsys):
    content = bytearray(whole.read_bytes())
    order = messages_of(whole)
    with open(whole, "rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    content[chunks[2].chunk_start_offset + 100] ^= 1
    damaged, good = tmp_path / "damaged.mcap", tmp_path / "good.mcap"
    damaged.write_bytes(content)
    assert main(["recover", str(damaged), "-o", str(good)]) == 0
    assert "behind or between them are lost" in capsys.readouterr().out
    check_log(good)
    kept = messages_of(good)
    assert set(kept) < set(order)
    lost = [message for message in order if message not in kept]
    assert all(chunks[2].message_start_time <= time <= chunks[2].message_end_time for _, time, _ in lost)
    with Reader(good) as reader:
        assert len(list(reader.messages())) == reader.message_count == len(kept)


@pytest.mark.parametrize("content", [None, b"", b"\x89MCAP", b"PK\x03\x04" + bytes(100), b"\x89MCAP0\r\n" + bytes(200)])
def test_what_cannot_be_recovered_is_said_in_one_line(tmp_path, capsys, content):
    path = tmp_path / "run.mcap"
    if content is not None:
        path.write_bytes(content)
    assert main(["recover", str(path), "-o", str(tmp_path / "good.mcap")]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith(f"cloth-sim: error: log {path}: ")
    assert main(["recover", str(path), "-o", str(path)]) == 2
    assert "both read and written" in capsys.readouterr().err


# -- a recording that cannot go on


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path)
    yield bench
    bench.worker.close()


def expect_recording_stopped(bench, reason):
    """One line everywhere, and the simulation goes on."""
    bench.listener.wait(lambda: bench.listener.warnings)
    [line] = bench.listener.warnings
    assert re.fullmatch(f"recording stopped: log .*{reason}.*", line)
    bench.wait_until_moved()
    assert bench.worker.describe()["recording"] is None
    assert bench.worker.describe()["recording_failure"] == line
    bench.worker.diagnose()
    assert line.encode() in bench.listener.of(DIAGNOSTICS)[-1]
    with pytest.raises(ClothError, match="nothing is being recorded; recording stopped: log"):
        bench.worker.record(False)
    # The next one is a new start.
    assert bench.worker.record(True).startswith("recording ")
    assert bench.worker.describe()["recording_failure"] is None
    bench.worker.record(False)
    assert bench.listener.warnings == [line]


def test_a_log_that_is_deleted_with_its_directory(bench, tmp_path):
    bench.give(handkerchief(), box=False)
    path = Path(bench.worker.record(True).removeprefix("recording "))
    bench.worker.start()
    bench.wait_until_moved()
    path.unlink()
    path.parent.rmdir()
    expect_recording_stopped(bench, "the file was removed while it was written")


def test_a_full_disk(bench, monkeypatch):
    room = 90_000
    monkeypatch.setattr("cloth_sim_ros.log_writer.CHUNK_SIZE", 20_000)

    class FullDisk:
        """A file on a disk that has only so much room."""

        def __init__(self, file):
            self._file = file

        def write(self, data):
            if self._file.tell() + len(data) > room:
                raise OSError(28, "No space left on device")
            return self._file.write(data)

        def __getattr__(self, name):
            return getattr(self._file, name)

    bench.give(handkerchief(), box=False)
    with monkeypatch.context() as patch:
        opened = []

        def open_small(path, mode, buffering):
            opened.append(open(path, mode, buffering=buffering))
            return FullDisk(opened[-1])

        patch.setattr("cloth_sim_ros.log_writer.open", open_small, raising=False)
        path = Path(bench.worker.record(True).removeprefix("recording "))
    bench.worker.start()
    expect_recording_stopped(bench, "No space left on device, [0-9]+ messages before it are kept")
    assert path.stat().st_size <= room
    check_log(path)
    with LogReader(path) as log:
        assert log.count(GARMENT) >= 1
        assert log.patterns() == [handkerchief()]


@pytest.mark.parametrize("place", ["file", "below a file", "forbidden"])
def test_a_directory_that_cannot_be_used_is_refused_at_once(bench, tmp_path, place):
    bench.give(handkerchief(), box=False)
    records = tmp_path / "records"
    if place == "file":
        records.write_text("in the way")
    elif place == "below a file":
        (tmp_path / "file").write_text("in the way")
        records.symlink_to(tmp_path / "file" / "records")
    else:
        records.symlink_to("/proc/1/fd/records")
    bench.worker.start()
    for command in (bench.worker.save, lambda: bench.worker.record(True)):
        with pytest.raises(ClothError, match=r"^record_directory '.*records': [^\n]*set it to a directory that can be"):
            command()
    bench.wait_until_moved()


RECORDING_AS_NOBODY = """
import os, sys
from cloth_core.errors import ClothError
from cloth_sim_ros.log_writer import LogWriter
from cloth_sim_ros.output_files import claim_path
if os.geteuid() == 0:
    os.setuid(65534)
try:
    claim_path(sys.argv[1], "name", (".mcap",), lambda path: LogWriter(f"{path}.mcap"))
except ClothError as error:
    print(error)
"""


def test_no_permission(tmp_path):
    records = tmp_path / "records"
    records.mkdir()
    for folder in (tmp_path, *tmp_path.parents):
        if not folder.stat().st_mode & 0o001:  # nobody must get as far as `records`
            folder.chmod(0o755)
    records.chmod(0o555)
    done = subprocess.run([sys.executable, "-c", RECORDING_AS_NOBODY, str(records)], capture_output=True, text=True)
    assert re.fullmatch(r"log .*: Permission denied; choose a directory that can be written\n", done.stdout), done
    assert list(records.iterdir()) == []


TWO_AT_ONCE = """
import sys, time
from cloth_sim_ros.log_writer import LogWriter
from cloth_sim_ros.output_files import claim_path
from cloth_sim_ros.messages import encode_string
from cloth_sim_ros.topics import REPORT
time.sleep(max(0.0, float(sys.argv[3]) - time.time()))
for _ in range(20):
    logs = []
    path = claim_path(sys.argv[1], "same", (".mcap",), lambda path: logs.append(LogWriter(f"{path}.mcap")))
    for number in range(3):
        logs[0].write(REPORT, number, encode_string(sys.argv[2]))
    logs[0].close()
    print(path)
"""


def test_two_processes_that_record_in_the_same_second_write_files_of_their_own(tmp_path):
    moment = time.time() + 2.0
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", TWO_AT_ONCE, str(tmp_path), name, str(moment)], stdout=subprocess.PIPE, text=True
        )
        for name in ("left", "right", "third")
    ]
    paths = {}
    for name, process in zip(("left", "right", "third"), processes, strict=True):
        for line in process.communicate()[0].splitlines():
            paths.setdefault(line, []).append(name)
        assert process.returncode == 0
    assert len(paths) == 60
    assert all(len(names) == 1 for names in paths.values())
    assert sorted(f"{path}.mcap" for path in paths) == sorted(map(str, tmp_path.glob("*.mcap")))
    for path, [name] in paths.items():
        assert [data for _, _, data in messages_of(f"{path}.mcap")] == [encode_string(name)] * 3


@pytest.mark.parametrize(
    "name", ["../../up", "/etc/passwd", "a\0b", "a\nb", "x" * 10**6, "", "..", "-rf", "näme", "CON"]
)
def test_a_name_cannot_lead_out_of_the_directory(tmp_path, name):
    records = tmp_path / "records"
    path = claim_path(records, name, (".json",), lambda path: Path(f"{path}.json").touch(exist_ok=False))
    assert path.parent == records
    assert [entry.name for entry in records.iterdir()] == [f"{path.name}.json"]
    assert re.fullmatch(r"[A-Za-z0-9_-]{1,90}", path.name)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["records"]


def test_a_link_that_leads_nowhere_is_not_followed(tmp_path, monkeypatch):
    monkeypatch.setattr("time.strftime", lambda *_: "20260101_000000")
    (tmp_path / "run_20260101_000000.mcap").symlink_to(tmp_path / "elsewhere.mcap")
    path = claim_path(tmp_path, "run", (".mcap",), lambda path: LogWriter(f"{path}.mcap").close())
    assert path.name == "run_20260101_000000_2"
    assert not (tmp_path / "elsewhere.mcap").exists()


def test_a_drape_goes_on_without_its_recording(tmp_path, capsys, monkeypatch):
    """The log is removed while it is written; the garment is there all the same, and the exit code says that all is not
    well.
    """
    log, report = tmp_path / "run.mcap", tmp_path / "report.json"
    frame = RunRecorder.frame

    def frame_and_removal(self, *arguments):
        frame(self, *arguments)
        log.unlink(missing_ok=True)

    monkeypatch.setattr(RunRecorder, "frame", frame_and_removal)
    pattern = tmp_path / "pattern.json"
    pattern.write_text(handkerchief())
    command = ["drape", str(pattern), "--body", "young", "--quality", "draft", "--max-time", "0.05"]
    monkeypatch.setattr("cloth_sim_ros.log_writer.FLUSH_INTERVAL", 0.001)
    assert main([*command, "--record", str(log), "--report", str(report)]) == 1
    said = capsys.readouterr()
    warnings = [line for line in said.err.splitlines() if "recording stopped" in line]
    assert len(warnings) == 2  # when it happened, and as the reason for the exit code
    assert re.fullmatch(r"cloth-sim: error: recording stopped: log .*: the file was removed .*", warnings[1])
    assert json.loads(report.read_text())["simulated_time"] >= 0.05
    assert f"wrote {report}" in said.out
    assert f"wrote {log}" not in said.out


def test_a_log_that_is_being_written_is_not_replaced(tmp_path, capsys):
    path = tmp_path / "run.mcap"
    command = ["drape", "rectangle", "--quality", "draft", "--max-time", "0.001", "--record", str(path)]
    log = LogWriter(path)
    assert main(command) == 1
    assert "another process is recording into it; choose another name" in capsys.readouterr().err
    log.close()
    assert messages_of(path) == []
    main(command)
    assert len(messages_of(path)) > 0
