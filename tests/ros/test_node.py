"""The node over DDS, with a client in another process: the whole job, and all that can be wrong with its input."""

import json
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from malformed_body_messages import MALFORMED_BODIES
from node_client import Client, NodeProcess
from rclpy.serialization import serialize_message
from small_scenes import BOX_TRIANGLES, BOX_VERTICES, handkerchief
from std_msgs.msg import String

from cloth_core.body import Body
from cloth_core.pattern import Pattern
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.messages import decode_marker, encode_mesh, encode_string
from cloth_sim_ros.node_parameters import PARAMETERS
from cloth_sim_ros.topics import BODY, BODY_MARKER, DIAGNOSTICS, GARMENT, PATTERN, REPORT

BOX = encode_mesh(BOX_VERTICES, BOX_TRIANGLES)


@pytest.fixture
def client():
    client = Client()
    yield client
    client.close()


@pytest.fixture
def start_node(tmp_path, client):
    def start(*arguments, **parameters):
        client.process = NodeProcess(tmp_path, *arguments, **parameters)
        return client.process

    yield start
    client.process.kill()


def garment_of(client, size):
    """Sends a handkerchief and waits until it is what the node has."""
    panel_area = size * size
    client.pattern.publish(encode_string(handkerchief(size)))
    client.wait(lambda: abs(((client.describe()["scene"] or {}).get("area") or 0.0) - panel_area) < 1e-9)


def test_pattern_and_body_in_drape_and_log_out(start_node, client):
    node = start_node()
    client.subscribe("garment", "body_marker", "report")
    assert not (answer := client.call("start")).success
    assert answer.message == "start: there is no garment; publish a pattern first"

    client.body.publish(BOX)
    client.wait(lambda: client.received["body_marker"])
    client.pattern.publish(encode_string(handkerchief()))
    description = client.wait_for_state("paused")
    assert description["scene"]["terms"]["body contact"]["active"]
    assert (recording := client.record(True)).success
    assert client.call("drape").success
    report = json.loads(client.wait(lambda: client.received["report"] and client.last("report").data))
    assert report["settled"]
    assert client.wait_for_state("rest")["report"] == report

    # It is the drape of the core, to the last bit.
    body = Body.from_arrays(BOX_VERTICES, BOX_TRIANGLES)
    simulation = Simulation(Scene.build(Pattern.from_json(handkerchief()), body, quality="draft"))
    assert report["state_sha256"] == simulation.settle().state_sha256
    marker = client.last("garment")
    points = np.array([[point.x, point.y, point.z] for point in marker.points])
    assert points.tobytes() == simulation.positions[simulation.triangles].tobytes()
    assert (marker.ns, marker.id, marker.header.frame_id) == ("garment", 0, "map")

    late_joiner = Client(own_name="late_joiner")
    late_joiner.subscribe("garment", "body_marker", "report")
    late_joiner.wait(lambda: all(late_joiner.received.values()))
    for name, messages in late_joiner.received.items():
        assert messages == [client.received[name][-1]]
    late_joiner.close()

    assert client.call("save").success
    client.wait(lambda: list(node.records.glob("*.glb")))
    [saved] = node.records.glob("*.json")
    assert json.loads(saved.read_text()) == report

    client.wait(lambda: client.diagnostics and "rest" in client.diagnostics[-1].status[0].message)
    assert (stopped := client.record(False)).success
    [path] = node.records.glob("*.mcap")
    assert recording.message == f"recording {path}"
    assert stopped.message == f"recorded {path}"
    with LogReader(path) as log:
        counts = {topic.name: log.count(topic) for topic in (PATTERN, BODY, BODY_MARKER, GARMENT, REPORT, DIAGNOSTICS)}
        # The transport fills up messages to a multiple of four bytes.
        logged = [message.data + bytes(-len(message.data) % 4) for message in log.messages(GARMENT)]
        assert log.report() == report
    assert all(counts.values()), counts
    # The log has the same bytes as the graph.
    assert logged[-1] == client.received["garment"][-1]
    assert set(client.received["garment"][3:]) <= set(logged)


def test_services_answer_while_it_runs(start_node, client):
    start_node()
    garment_of(client, 0.6)
    assert client.call("start").message == "running"
    times = [client.describe()["progress"]["simulated_time"] for _ in range(20)]
    client.wait(lambda: client.describe()["progress"]["simulated_time"] > times[0])
    assert client.call("pause").success
    assert client.describe()["state"] == "paused"
    assert client.call("step").message == "one step of 0.03333 s"
    assert client.call("reset").success
    client.wait(lambda: client.describe()["progress"]["simulated_time"] == 0.0)


def test_a_second_pattern_replaces_the_first_mid_run(start_node, client):
    start_node(auto_start=True)
    client.subscribe("garment")
    garment_of(client, 0.2)
    client.wait(lambda: len(client.received["garment"]) > 2)
    garment_of(client, 0.3)
    count = len(simulated(0.3).triangles)
    client.wait(lambda: len(client.last("garment").points) == 3 * count)
    seen = len(client.received["garment"])
    client.wait(lambda: len(client.received["garment"]) > seen)
    sizes = [len(decode_marker(message).points) for message in client.received["garment"]]
    assert sizes == sorted(sizes)


def simulated(size):
    return Simulation(Scene.build(Pattern.from_json(handkerchief(size)), quality="draft"))


def test_malformed_messages_are_refused_and_the_old_garment_goes_on(start_node, client):
    node = start_node(max_triangles=1000)
    client.subscribe("garment")
    client.pattern.publish(encode_string("cloth"))
    client.wait(lambda: refusal(client))
    assert not (answer := client.call("start")).success
    assert re.fullmatch("start: there is no garment; pattern refused: not JSON.*", answer.message)
    garment_of(client, 0.25)
    scene = client.describe()["scene"]
    client.call("start")
    patterns = {
        "not a string": (b"\x00\x01\x00\x00\xff\xff\xff\xff", "pattern message: data needs 4294967295 bytes"),
        "no JSON": (encode_string("cloth"), "not JSON"),
        "no panels": (encode_string('{"pattern": {}, "properties": {"units_in_meter": 1}}'), "panels"),
        "a path": (encode_string("/etc/passwd"), "not JSON"),
    }
    # DDS does not send an empty message and fills up others to a multiple of four bytes.
    bodies = {what: body for what, body in MALFORMED_BODIES.items() if body[0] and len(body[0]) % 4 == 0}
    assert len(bodies) >= 20
    for publisher, messages in ((client.body, bodies), (client.pattern, patterns)):
        for what, (data, complaint) in messages.items():
            publisher.publish(data)
            refused = client.wait(lambda complaint=complaint: complaint in (said := refusal(client)) and said)
            assert "\n" not in refused, what
            assert client.call("start").message == f"running; {refused}"
    described = client.describe()
    assert described["scene"] == scene
    assert described["state"] == "running"

    warned = client.wait(lambda: [m.status[0] for m in client.diagnostics if refused in m.status[0].message])
    assert warned[-1].level == b"\x01"
    assert refused in node.errors()
    assert "Traceback" not in node.errors()
    before = len(client.received["garment"])
    client.wait(lambda: len(client.received["garment"]) > before)
    garment_of(client, 0.2)
    assert refusal(client) == ""


def refusal(client):
    return client.describe()["refused"] or ""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_node_and_its_log(start_node, client, number):
    node = start_node(auto_start=True)
    client.subscribe("garment")
    garment_of(client, 0.3)
    path = client.record(True).message.removeprefix("recording ")
    before = len(client.received["garment"])
    client.wait(lambda: len(client.received["garment"]) > before + 3)
    assert node.end(number) == 0
    assert "Traceback" not in node.errors()
    with LogReader(path) as log:
        assert log.count(GARMENT) > 3
        assert log.patterns() == [handkerchief(0.3)]


LOADED = "from cloth_sim_ros.node import main; print('loaded', flush=True); main()"


def test_a_signal_at_any_time_of_the_start_ends_the_node_without_a_word(tmp_path):
    """While it warms up, makes its context, appears on the graph, and begins to serve."""
    for delay, number in ((0.07, signal.SIGINT), (1.0, signal.SIGTERM), (1.9, signal.SIGINT), (2.2, signal.SIGTERM)):
        node = subprocess.Popen(
            [sys.executable, "-c", LOADED], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
        )
        try:
            assert node.stdout.readline() == "loaded\n"
            time.sleep(delay)
            node.send_signal(number)
            _, errors = node.communicate(timeout=60)
        finally:
            node.kill()
            node.wait()
        assert (node.returncode, errors) == (0, ""), delay


def test_parameters(start_node, client):
    start_node()
    garment_of(client, 0.2)
    refused = [
        ("fabric", "tinfoil", "silk"),
        ("quality", "superb", "draft, normal, fine"),
        ("pattern", "/etc/passwd", "not known; use one of"),
        ("body", "../young", "not known; use one of"),
        ("frame_id", "", "give a name without spaces"),
        ("frame_id", "/map", "give a name without spaces"),
        ("record_directory", "", "give a directory"),
        ("garment_color", [1.0, 0.5], "red, green, blue and alpha"),
        ("body_color", [1.0, 0.5, 0.0, 2.0], "red, green, blue and alpha"),
        ("gravity", -1.0, "range"),
        ("gravity", float("nan"), ""),
        ("gravity", "strong", "type"),
        ("publish_rate", 0.0, "range"),
        ("max_particles", 0, "range"),
        ("tolerance", -1.0, "range"),
        ("air_drag", float("inf"), "range"),
    ]
    for name, value, reason in refused:
        before = client.get_parameter(name)
        result = client.set_parameter(name, value)
        assert not result.successful, (name, value)
        assert reason in result.reason
        assert client.get_parameter(name) == before

    assert client.set_parameter("fabric", "denim").successful
    assert client.describe()["scene"]["fabric"] == "cotton_poplin"
    client.call("reset")
    client.wait(lambda: client.describe()["scene"]["fabric"] == "denim")
    assert client.set_parameter("publish_rate", 10.0).successful
    assert client.call("step").message == "one step of 0.1 s"
    assert client.set_parameter("pattern", "rectangle").successful
    client.wait(lambda: client.describe()["scene"]["garment"] == "rectangle")
    assert client.set_parameter("max_particles", 50).successful
    client.call("reset")
    client.wait(lambda: "max_particles = 50" in refusal(client))


def test_parameters_are_described(start_node, client):
    start_node()
    descriptors = client.describe_parameters([parameter.name for parameter in PARAMETERS])
    for parameter, descriptor in zip(PARAMETERS, descriptors, strict=True):
        assert len(descriptor.description) > 10
        assert re.search(r"Acts (at once|with the next|at start)", descriptor.description)
        if isinstance(parameter.default, float):
            assert re.search(r"\[[^]]+\]", descriptor.description), "its unit"
        if isinstance(parameter.default, float | int) and not isinstance(parameter.default, bool):
            assert descriptor.floating_point_range or descriptor.integer_range
        elif not isinstance(parameter.default, bool):
            assert descriptor.additional_constraints


def test_a_node_with_a_name_and_namespace_of_its_own(start_node):
    node = start_node("-r", "__ns:=/tailor", "-r", "__node:=left", pattern="rectangle")
    client = Client("/tailor/left")
    client.subscribe("garment")
    client.wait(lambda: client.received["garment"])
    path = client.record(True).message.removeprefix("recording ")
    client.call("step")
    client.wait(lambda: len(client.received["garment"]) > 2)
    assert client.record(False).success
    with LogReader(path) as log:
        assert {message.topic for message in log.messages()} >= {"/tailor/left/garment", "/tailor/left/pattern"}
    client.close()
    assert node.end() == 0


@pytest.mark.parametrize(("name", "value"), [("fabric", "tinfoil"), ("gravity", "-1.0"), ("max_particles", "many")])
def test_a_node_with_nonsense_for_a_parameter_ends_with_one_line(start_node, name, value):
    node = start_node(**{name: value})
    assert node.wait() == 1
    errors = node.errors()
    assert re.search(rf"^cloth_sim_node: .*{name}", errors, re.MULTILINE), errors
    assert "Traceback" not in errors


def test_a_huge_pattern_message_is_refused(start_node, client):
    start_node()
    client.pattern.publish(serialize_message(String(data=" " * 20_000_000)))
    client.wait(lambda: "bytes are more than" in refusal(client))
    assert client.describe()["scene"] is None
