"""A log in a thread of its own: the same log as without one, and one complaint when it cannot be written."""

import threading
from pathlib import Path

import pytest

from cloth_sim_ros.background_log import MOST_WAITING, BackgroundLog
from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.log_writer import LogError, LogWriter
from cloth_sim_ros.messages import encode_string
from cloth_sim_ros.topics import PATTERN, REPORT


def no_failure(log, error):
    raise AssertionError(error)


def test_all_messages_are_there_in_order_once_it_is_closed(tmp_path):
    path = tmp_path / "run.mcap"
    log = BackgroundLog(LogWriter(path), no_failure)
    sent = [encode_string(f"{number}" * 1000) for number in range(5 * MOST_WAITING)]
    for number, data in enumerate(sent):
        log.write(PATTERN if number % 2 else REPORT, number, data)
    log.close()
    with LogReader(path) as reader:
        messages = list(reader.messages())
    assert [message.log_time for message in messages] == list(range(len(sent)))
    assert [message.data for message in messages] == sent


class Full:
    """A log whose disk is full after the third message."""

    path = Path("full.mcap")

    def __init__(self):
        self.written, self.blocked = 0, threading.Event()

    def write(self, topic, log_time, data):
        self.blocked.wait(30)
        self.written += 1
        if self.written > 3:
            raise LogError("log full.mcap: No space left on device")

    def close(self):
        raise AssertionError("it was closed by its failure")


def test_a_failure_is_told_once_and_what_follows_is_dropped():
    full, told = Full(), []
    log = BackgroundLog(full, lambda failed, error: told.append((failed, str(error))))
    full.blocked.set()
    for number in range(3 * MOST_WAITING):
        log.write(PATTERN, number, b"")
    with pytest.raises(LogError, match="No space left"):
        log.close()
    assert told == [(log, "log full.mcap: No space left on device")]
    assert full.written == 4


def test_who_sends_waits_for_a_disk_that_is_too_slow():
    full = Full()
    log = BackgroundLog(full, lambda *_: None)
    sent = []

    def send():
        for number in range(MOST_WAITING + 3):
            log.write(PATTERN, number, b"")
            sent.append(number)

    sender = threading.Thread(target=send)
    sender.start()
    sender.join(0.5)
    assert sender.is_alive()
    assert len(sent) <= MOST_WAITING + 1
    full.blocked.set()
    sender.join(30)
    assert len(sent) == MOST_WAITING + 3
    with pytest.raises(LogError):
        log.close()
