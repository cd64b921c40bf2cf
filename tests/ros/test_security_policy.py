"""The SROS 2 policy names what the node has on its graph, all of it and nothing else."""

import time
from importlib import resources
from xml.etree import ElementTree

import pytest
from node_client import NodeProcess
from rclpy.context import Context
from rclpy.node import Node

POLICY = resources.files("cloth_sim_ros") / "security" / "cloth_sim.policy.xml"
PATIENCE = 60.0
OWN = {"/cloth_sim/_sent", "/parameter_events"}
"""From the node to itself."""


def rules(enclave):
    """(kind, permission) -> names, as sros2 resolves them."""
    root = ElementTree.fromstring(POLICY.read_text(encoding="utf-8"))
    assert root.get("version") == "0.2.0"
    [profile] = root.findall(f"./enclaves/enclave[@path='/{enclave}']/profiles/profile")
    node = profile.get("ns") + profile.get("node")
    found = {}
    for group in profile:
        [(permission, qualifier)] = group.attrib.items()
        assert qualifier == "ALLOW"
        names = [entry.text.replace("~", node, 1) for entry in group]
        assert len(names) == len(set(names))
        assert all(name.startswith("/") for name in names)
        found[permission] = set(names)
    return found


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    """What a running node has, as another participant sees it."""
    process = NodeProcess(tmp_path_factory.mktemp("policy"))
    context = Context()
    context.init()
    observer = Node("observer", context=context)
    queries = {
        "publish": observer.get_publisher_names_and_types_by_node,
        "subscribe": observer.get_subscriber_names_and_types_by_node,
        "reply": observer.get_service_names_and_types_by_node,
    }
    deadline = time.monotonic() + PATIENCE
    try:
        found = before = {}
        while not found or found != before or not found["reply"]:
            assert time.monotonic() < deadline, found
            time.sleep(0.5)
            before = found
            if ("cloth_sim", "/") in observer.get_node_names_and_namespaces():
                found = {key: {name for name, _ in query("cloth_sim", "/")} for key, query in queries.items()}
    finally:
        observer.destroy_node()
        context.try_shutdown()
        process.kill()
    return found


@pytest.mark.parametrize("permission", ["publish", "subscribe", "reply"])
def test_the_node_may_do_what_it_does_and_no_more(graph, permission):
    # Where time is simulated, rclpy subscribes to /clock, and a node that hears parameter events says so.
    allowed = rules("cloth_sim")[permission] - {"/parameter_events"}
    assert graph[permission] - {"/parameter_events"} == allowed


def test_the_operator_can_ask_for_all_that_the_node_offers(graph):
    operator = rules("cloth_sim_operator")
    assert operator["request"] == graph["reply"]
    own = {name for name in operator["publish"] if name.startswith("/cloth_sim/")}
    assert own == graph["subscribe"] - OWN
    assert operator["subscribe"] - {"/parameter_events"} == graph["publish"] - OWN - {"/rosout"}


def test_the_viewer_can_change_nothing():
    viewer = rules("cloth_sim_viewer")
    assert set(viewer) == {"publish", "subscribe"}
    assert viewer["publish"] == {"/rosout", "/parameter_events"}
    assert viewer["subscribe"] == rules("cloth_sim_operator")["subscribe"]
