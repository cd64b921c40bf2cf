"""What acts on the cloth while it runs, over DDS: grippers, a body that moves; and nodes side by side."""

import json

import numpy as np
import pytest
from node_client import Client, NodeProcess
from small_scenes import BOX_TRIANGLES, BOX_VERTICES, handkerchief

from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.messages import decode_marker, encode_mesh, encode_string
from cloth_sim_ros.topics import BODY

BOX = encode_mesh(BOX_VERTICES, BOX_TRIANGLES)
OFFSET = 0.003


@pytest.fixture(scope="module")
def clients(tmp_path_factory):
    """Clients of two nodes in namespaces of their own, each with a handkerchief above a box."""
    clients = []
    for name in ("/left_hand", "/right_hand"):
        client = Client(f"{name}/cloth_sim", own_name=f"client_of{name.replace('/', '_')}")
        client.process = NodeProcess(tmp_path_factory.mktemp("node"), "-r", f"__ns:={name}")
        client.subscribe("garment", "body_marker", "report")
        client.body.publish(BOX)
        client.pattern.publish(encode_string(handkerchief()))
        clients.append(client)
    for client in clients:
        client.wait(lambda client=client: client.describe()["scene"] and client.describe()["scene"]["body"])
    yield clients
    for client in clients:
        client.process.kill()
        client.close()


def points(client):
    return decode_marker(client.received["garment"][-1]).points


def drape(client):
    """Until it lies on the box."""
    seen = len(client.received["report"])
    assert client.call("drape").success
    client.wait(lambda: len(client.received["report"]) > seen)
    stamp = client.wait_for_state("rest")["stamp"]
    # Messages of different topics may overtake each other.
    client.wait(lambda: decode_marker(client.received["garment"][-1]).stamp == stamp)


def test_nodes_side_by_side_do_not_disturb_each_other(clients):
    one, other = clients
    seen = len(other.received["garment"])
    drape(one)
    assert other.describe()["progress"]["simulated_time"] == 0.0
    other.wait(lambda: {m.status[0].name for m in other.diagnostics} == {
        f"{client.node_name.lstrip('/')}: simulation" for client in clients
    })  # fmt: skip
    assert len(other.received["garment"]) == seen


def test_a_gripper_lifts_a_handkerchief_off_a_box_and_drops_it(clients):
    client = clients[0]
    drape(client)
    middle = points(client)[np.argmin(np.linalg.norm(points(client)[:, :2], axis=1))]
    assert middle[2] == pytest.approx(0.1 + OFFSET, abs=1e-3)
    assert not (answer := client.call("gripper/release")).success
    assert answer.message == "gripper: it holds nothing; grasp first"
    client.wait(lambda: client.move_gripper("gripper", middle) or client.call("gripper/grasp").success)
    client.wait(lambda: client.describe()["grippers"])
    client.wait_for_state("rest")  # held still, it comes to rest again
    refused = client.call("gripper/grasp")
    assert not refused.success
    assert "it holds cloth already" in refused.message

    # At rest; the moving gripper lets the run go on by itself.
    goal = middle + np.array([0.0, 0.3, 0.5])
    # Poses are sent as sensors send them: again and again, because one may get lost.
    client.wait(
        lambda: client.move_gripper("gripper", goal) or np.linalg.norm(points(client) - goal, axis=1).min() < 1e-6
    )
    gripper = client.describe()["grippers"]["gripper"]
    assert gripper["arrived"]
    assert gripper["lag"] < 1e-6
    # It hangs from the gripper.
    client.wait(lambda: points(client)[:, 2].min() < goal[2] - 0.1)

    assert client.call("gripper/release").success
    client.wait(lambda: points(client)[:, 2].max() < goal[2] - 0.3)
    client.call("pause")


def test_poses_that_cannot_be_used_are_refused(clients):
    client = clients[0]
    for arguments, complaint in (
        ({"position": [0, 0, 0], "frame_id": "camera"}, "its frame is 'camera', not 'map'"),
        ({"position": [np.nan, 0, 0]}, "not a finite position"),
        ({"position": [0, 0, 0], "orientation": [0, 0, 0, 0]}, "no direction"),
    ):
        client.wait(
            lambda a=arguments, c=complaint: (
                client.move_gripper("gripper", **a) or c in (client.describe()["refused"] or "")
            )
        )
        assert "gripper" in client.describe()["refused"]


def test_a_body_that_comes_again_takes_the_cloth_along(clients):
    client = clients[1]
    drape(client)
    [before] = {message for message in client.received["body_marker"][-1:]}
    path = client.record(True).message.removeprefix("recording ")
    # Slowly: where the box stops, what it carries flies on for 2 v / g, here 25 ms at 63 mm/s.
    assert client.set_parameter("body_move_duration", 0.8).successful
    time, lowest = client.describe()["progress"]["simulated_time"], points(client).mean(axis=0)
    moved = BOX_VERTICES + np.array([0.05, 0.0, 0.1])
    client.body.publish(encode_mesh(moved, BOX_TRIANGLES))
    client.wait(lambda: client.describe()["progress"]["simulated_time"] > time + 0.8)
    client.wait_for_state("rest")
    # No restart, and friction has carried the handkerchief with the box.
    assert client.describe()["progress"]["simulated_time"] > time
    assert points(client).mean(axis=0) - lowest == pytest.approx([0.05, 0.0, 0.1], abs=5e-3)
    there = pytest.approx(moved[BOX_TRIANGLES].reshape(-1, 3), abs=1e-12)
    client.wait(lambda: decode_marker(client.received["body_marker"][-1]).points == there)
    assert decode_marker(client.received["body_marker"][-1]).stamp > decode_marker(before).stamp
    report = json.loads(client.last("report").data)
    assert report["settled"]
    assert report["body_intersections"] == 0
    late_joiner = Client(client.node_name, own_name="late_joiner")
    late_joiner.subscribe("body_marker")
    late_joiner.wait(lambda: late_joiner.received["body_marker"])
    assert late_joiner.received["body_marker"] == client.received["body_marker"][-1:]
    late_joiner.close()
    assert client.record(False).success
    with LogReader(path) as log:
        assert [len(message.data) for message in log.messages(BODY)] == [len(BOX)] * 2
        # The last body of the log is where it has moved to.
        assert [message.data for message in log.messages(BODY)][-1] == encode_mesh(moved, BOX_TRIANGLES)

    # Reset starts around the body where it is now.
    stamp = client.describe()["stamp"]
    assert client.call("reset").success
    client.wait(lambda: client.describe()["progress"]["simulated_time"] == 0.0)
    shown = decode_marker(client.received["body_marker"][-1]).stamp
    client.wait(lambda: decode_marker(client.received["body_marker"][-1]).stamp != shown or shown > stamp)
    assert decode_marker(client.received["body_marker"][-1]).points == there
