"""Every parameter of the node has the effect that its description promises, over DDS."""

import json
import time

import numpy as np
import pytest
from node_client import Client, NodeProcess
from rosgraph_msgs.msg import Clock
from small_scenes import BOX_TRIANGLES, BOX_VERTICES, handkerchief

from cloth_core.calibration import Cloth
from cloth_core.fabric import Fabric
from cloth_core.quality import QUALITIES, settings_for
from cloth_sim_ros.messages import decode_marker, encode_mesh, encode_string
from cloth_sim_ros.node_parameters import PARAMETERS

GRAVITY = 9.80665
DEFAULTS = {parameter.name: parameter.default for parameter in PARAMETERS} | {"quality": "draft"}


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """A client of one node with a handkerchief in free fall and two grippers."""
    client = Client()
    client.process = NodeProcess(tmp_path_factory.mktemp("node"), grippers="[left, right]")
    client.subscribe("garment", "body_marker")
    client.clock = []
    client._node.create_subscription(Clock, "/clock", client.clock.append, 10)
    client.pattern.publish(encode_string(handkerchief(0.2)))
    client.wait_for_state("paused")
    yield client
    client.process.kill()
    client.close()


@pytest.fixture
def change(client):
    """Sets parameters for one test."""
    changed = []

    def change(name, value):
        result = client.set_parameter(name, value)
        assert result.successful, result.reason
        changed.append(name)

    yield change
    client.call("pause")
    for name in changed:
        assert client.set_parameter(name, DEFAULTS[name]).successful


def time_of(client):
    return client.describe()["progress"]["simulated_time"]


def reset(client):
    before = client.describe()["stamp"]
    assert client.call("reset").success
    # A run starts later than all that has been sent.
    client.wait(lambda: (said := client.describe())["stamp"] > before and said["progress"]["simulated_time"] == 0.0)
    said = client.wait_for_state("paused")
    # Frames go out in a thread of their own.
    client.wait(lambda: decode_marker(client.received["garment"][-1]).stamp == client.describe()["stamp"])
    return said


def step(client):
    before = time_of(client)
    assert client.call("step").success
    client.wait(
        lambda: (said := client.describe())["state"] == "paused" and said["progress"]["simulated_time"] > before
    )
    stamp = client.describe()["stamp"]
    client.wait(lambda: decode_marker(client.received["garment"][-1]).stamp == stamp)
    return decode_marker(client.received["garment"][-1]).points


def fallen(drag, seconds):
    """Way of free fall with air drag per mass and speed [m]."""
    return GRAVITY / drag * (seconds - (1 - np.exp(-drag * seconds)) / drag)


def fabric(client, change):
    area = reset(client)["scene"]["area"]
    change("fabric", "denim")
    assert reset(client)["scene"]["mass"] == pytest.approx(area * Fabric.preset("denim").area_density, rel=1e-3)


def quality(client, change):
    change("quality", "fine")
    assert reset(client)["scene"]["spacing"] == QUALITIES["fine"]


def tolerance(client, change):
    change("tolerance", 8.0)
    scene = reset(client)["scene"]
    area = scene["area"]
    assert scene["spacing"] != QUALITIES["normal"]  # which it had without a tolerance
    allowed = settings_for("normal", 0.008, Cloth.of(area, Fabric.preset("cotton_poplin"))).spacing
    assert reset(client)["scene"]["spacing"] == allowed


def gravity(client, change):
    change("gravity", 0.0)
    reset(client)
    first = decode_marker(client.received["garment"][-1]).points
    assert step(client) == pytest.approx(first, abs=1e-9)


def air_drag(client, change):
    change("step_duration", 0.1)
    for drag in (2.0, 20.0):
        change("air_drag", drag)
        reset(client)
        first = decode_marker(client.received["garment"][-1]).points
        assert (first - step(client))[:, 2] == pytest.approx(fallen(drag, 0.1), rel=0.02)


def without(client, change):
    assert reset(client)["scene"]["terms"]["gravity"]["active"]
    refused = client.set_parameter("without", ["gravity", "wind"])
    assert not refused.successful
    assert refused.reason.startswith("without 'wind': no term that can be switched off; use some of gravity, ")
    change("without", ["gravity", "friction"])
    assert client.describe()["scene"]["terms"]["gravity"]["active"]  # of the garment that is there
    terms = reset(client)["scene"]["terms"]
    assert [name for name, term in terms.items() if term["reason"] == "switched off by hand"] == ["gravity", "friction"]
    first = decode_marker(client.received["garment"][-1]).points
    assert step(client) == pytest.approx(first, abs=1e-9)


def frame_id(client, change):
    change("frame_id", "room")
    reset(client)
    client.wait(lambda: client.last("garment").header.frame_id == "room")


def color(topic):
    def probe(client, change):
        client.body.publish(encode_mesh(BOX_VERTICES - [0, 0, 5], BOX_TRIANGLES))
        client.wait(lambda: client.received["body_marker"])
        change(f"{topic.removesuffix('_marker')}_color", [0.5, 0.25, 0.125, 1.0])
        reset(client)
        client.wait(lambda: decode_marker(client.received[topic][-1]).color == (0.5, 0.25, 0.125, 1.0))

    return probe


def publish_rate(client, change):
    change("publish_rate", 40.0)
    reset(client)
    step(client)
    assert time_of(client) == pytest.approx(1 / 40, rel=1e-9)


def auto_start(client, change):
    change("auto_start", True)
    client.call("reset")
    client.wait(lambda: client.describe()["state"] == "running" and time_of(client) > 0.0)


def paused(client, change):
    reset(client)
    change("paused", True)
    assert client.call("start").message == "running, once the parameter paused is false"
    assert client.describe()["state"] == "paused"
    step(client)
    change("paused", False)
    client.call("start")
    client.wait(lambda: client.describe()["state"] == "running" and time_of(client) > 0.1)
    change("paused", True)
    client.wait_for_state("paused")

    def is_halted():
        before = time_of(client)
        time.sleep(0.2)
        return time_of(client) == before

    client.wait(is_halted)  # the steps that are being done are done to their end


def real_time_factor(client, change):
    change("gravity", 0.0)
    change("real_time_factor", 0.05)
    reset(client)
    began = time.monotonic()
    client.call("start")
    client.wait(lambda: time_of(client) > 0.05)
    assert time.monotonic() - began > 0.7


def step_duration(client, change):
    reset(client)
    change("step_duration", 0.007)
    step(client)
    assert time_of(client) == pytest.approx(0.007, rel=1e-9)


def publish_clock(client, change):
    assert not client.clock
    change("publish_clock", True)
    reset(client)
    step(client)
    stamp = client.describe()["stamp"]
    client.wait(lambda: client.clock and nanoseconds(client.clock[-1].clock) == stamp)
    client.call("start")
    seen = len(client.clock)
    client.wait(lambda: len(client.clock) > seen + 10)
    stamps = [nanoseconds(message.clock) for message in client.clock]
    assert stamps == sorted(stamps)
    change("publish_clock", False)
    client.call("pause")


def nanoseconds(stamp):
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def grippers(client, change):
    assert {"right/grasp", "left/release"} <= {
        name.removeprefix("/cloth_sim/") for name, _ in client._node.get_service_names_and_types()
    }
    refused = client.set_parameter("grippers", ["thumb"])
    assert not refused.successful
    assert "read-only" in refused.reason


def corner_of(client):
    points = decode_marker(client.received["garment"][-1]).points
    return points[np.argmax(points.sum(axis=1))]


def grasp_at(client, name, position):
    """Answer of a gripper that knows its pose; poses are sent as streams are, until one has arrived."""
    return client.wait(
        lambda: (
            client.move_gripper(name, position) or ("known" not in (a := client.call(f"{name}/grasp")).message and a)
        )
    )


def grasp(client, name="left"):
    """Grasps a corner of the handkerchief; the answer."""
    answer = grasp_at(client, name, corner_of(client))
    if answer.success:
        client.wait(lambda: client.describe()["grippers"])
    return answer


def grasp_radius(client, change):
    reset(client)
    change("grasp_radius", 0.001)
    assert "the nearest is" in grasp_at(client, "right", [1.0, 0.0, 0.0]).message
    held = [int(grasp(client).message.split()[2])]
    client.call("left/release")
    change("grasp_radius", 0.05)
    held.append(int(grasp(client).message.split()[2]))
    assert held[0] == 1
    assert held[1] > 3


def grasp_speed(client, change):
    change("step_duration", 0.1)
    change("grasp_speed", 0.02)
    reset(client)
    assert grasp(client).success
    start = np.array(client.describe()["grippers"]["left"]["position"])
    deadline, way = time.monotonic() + 30, 0.0
    while way == 0.0:
        client.move_gripper("left", start + np.array([0.0, 0.0, 0.1]))
        step(client)
        way = client.describe()["grippers"]["left"]["position"][2] - start[2]
        assert time.monotonic() < deadline
    assert way <= 0.02 * 0.1 * (1 + 1e-9)


def with_box_below(client):
    client.set_parameter("step_duration", 0.02)
    client.body.publish(encode_mesh(BOX_VERTICES - [0, 0, 5], BOX_TRIANGLES))
    client.wait(lambda: client.describe()["scene"]["body"])
    reset(client)
    step(client)


def body_move_duration(client, change):
    with_box_below(client)
    goal = BOX_VERTICES - [0.0, 0.01, 5.0]
    change("body_move_duration", 0.02)
    client.body.publish(encode_mesh(goal, BOX_TRIANGLES))
    client.wait(lambda: client.describe()["body_moves"])
    before = time_of(client)
    step(client)
    step(client)
    assert time_of(client) > before > 0.0
    there = pytest.approx(goal[BOX_TRIANGLES].reshape(-1, 3), abs=1e-12)
    client.wait(lambda: decode_marker(client.received["body_marker"][-1]).points == there)
    change("body_move_duration", 0.0)
    client.body.publish(encode_mesh(BOX_VERTICES - [0, 0, 5], BOX_TRIANGLES))
    client.wait(lambda: time_of(client) == 0.0)
    change("step_duration", 0.0)


def body_speed(client, change):
    with_box_below(client)
    change("body_speed", 0.5)
    client.body.publish(encode_mesh(BOX_VERTICES - [1.0, 0.0, 5.0], BOX_TRIANGLES))
    client.wait(lambda: client.describe()["body_moves"])
    step(client)
    stamp = client.describe()["stamp"]
    client.wait(lambda: decode_marker(client.received["body_marker"][-1]).stamp == stamp)
    moved = BOX_VERTICES[0, 0] - decode_marker(client.received["body_marker"][-1]).points[:, 0].min()
    assert 0.0 < moved <= 0.5 * 0.02 * (1 + 1e-9)
    change("step_duration", 0.0)


def record_directory(client, change, tmp_path):
    change("record_directory", str(tmp_path / "there"))
    assert client.record(True).message.startswith(f"recording {tmp_path / 'there'}/")
    assert client.record(False).success
    assert list((tmp_path / "there").glob("*.mcap"))


def max_particles(client, change):
    change("max_particles", 10)
    client.call("reset")
    client.wait(lambda: "max_particles = 10" in (client.describe()["refused"] or ""))


def max_triangles(client, change):
    change("max_triangles", 5)
    client.body.publish(encode_mesh(BOX_VERTICES, BOX_TRIANGLES))
    client.wait(lambda: "max_triangles = 5" in (client.describe()["refused"] or ""))


def builtin(name, value):
    def probe(client, change):
        key = {"pattern": "garment", "body": "body"}[name]
        change(name, value)
        client.wait(lambda: client.describe()["scene"][key] == value)

    return probe


# The body and the pattern last: what comes before is about the handkerchief.
PROBES = {
    "publish_clock": publish_clock,
    "fabric": fabric,
    "quality": quality,
    "tolerance": tolerance,
    "gravity": gravity,
    "air_drag": air_drag,
    "without": without,
    "frame_id": frame_id,
    "publish_rate": publish_rate,
    "auto_start": auto_start,
    "paused": paused,
    "real_time_factor": real_time_factor,
    "step_duration": step_duration,
    "grippers": grippers,
    "grasp_radius": grasp_radius,
    "grasp_speed": grasp_speed,
    "max_particles": max_particles,
    "max_triangles": max_triangles,
    "garment_color": color("garment"),
    "body_color": color("body_marker"),
    "body_move_duration": body_move_duration,
    "body_speed": body_speed,
    "pattern": builtin("pattern", "rectangle"),
    "body": builtin("body", "young"),
}


@pytest.mark.parametrize("name", PROBES)
def test_parameter_has_its_effect(client, change, name):
    PROBES[name](client, change)


def test_record_directory_has_its_effect(client, change, tmp_path):
    record_directory(client, change, tmp_path)


def test_no_parameter_is_forgotten(client):
    assert {*PROBES, "record_directory"} == {parameter.name for parameter in PARAMETERS}
    table = client.describe()["node_parameters"]
    assert set(table) == set(DEFAULTS)
    descriptors = client.describe_parameters(list(table))
    for (name, entry), descriptor in zip(table.items(), descriptors, strict=True):
        assert descriptor.description.startswith(entry["description"]), name
        assert f"Acts {entry['acts']}." in descriptor.description
        assert entry["read_only"] == descriptor.read_only
        assert json.loads(json.dumps(entry)) == entry
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        assert entry["range"] == ([ranges[0].from_value, ranges[0].to_value] if ranges else None)
