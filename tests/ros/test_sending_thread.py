"""Messages are sent in their order by a thread of its own, which nobody waits for unless there are too many."""

import threading
import time

from cloth_sim_ros.sending_thread import SendingThread

PATIENCE = 30.0


def no_error(what, error):
    raise AssertionError(f"{what}: {error}")


def test_all_is_sent_in_order_by_the_end():
    sent = []
    sending = SendingThread(no_error)
    for number in range(1000):
        sending.send("number", sent.append, b"%d" % number)
    sending.close(PATIENCE)
    assert sent == [b"%d" % number for number in range(1000)]


def test_who_sends_does_not_wait_for_what_is_slow_but_sees_that_it_is_behind():
    gate, sent, begun = threading.Event(), [], threading.Event()

    def slow(data):
        begun.set()
        assert gate.wait(PATIENCE)
        sent.append(data)

    sending = SendingThread(no_error)
    sending.send("first", slow, b"first")
    assert begun.wait(PATIENCE)
    assert not sending.is_behind()  # the one that is being sent makes no other wait
    sending.send("second", slow, b"second")
    assert sending.is_behind()
    assert sent == []
    gate.set()
    sending.close(PATIENCE)
    assert sent == [b"first", b"second"]
    assert not sending.is_behind()


def test_what_waits_is_limited_and_a_larger_message_goes_alone():
    gate, sent = threading.Event(), []

    def slow(data):
        assert gate.wait(PATIENCE)
        sent.append(len(data))

    sending = SendingThread(no_error, capacity=100)
    sending.send("larger than all", slow, bytes(200))
    blocked = threading.Thread(target=sending.send, args=("next", slow, bytes(60)))
    blocked.start()
    blocked.join(0.2)
    assert blocked.is_alive()
    gate.set()
    blocked.join(PATIENCE)
    assert not blocked.is_alive()
    sending.close(PATIENCE)
    assert sent == [200, 60]


def test_an_error_is_told_and_the_next_is_sent():
    errors, sent = [], []

    def broken(data):
        raise RuntimeError("no context")

    sending = SendingThread(lambda what, error: errors.append(f"{what}: {error}"))
    sending.send("garment", broken, b"")
    sending.send("report", sent.append, b"data")
    sending.close(PATIENCE)
    assert errors == ["garment: no context"]
    assert sent == [b"data"]


def test_closing_does_not_wait_for_ever_for_what_never_ends():
    gate = threading.Event()
    sending = SendingThread(no_error)
    sending.send("stuck", lambda _: gate.wait(PATIENCE), b"")
    began = time.monotonic()
    sending.close(0.1)
    assert time.monotonic() - began < PATIENCE / 2
    gate.set()
