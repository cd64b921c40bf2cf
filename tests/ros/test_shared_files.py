"""Launch file, parameter file, view and message definitions fit the node and each other."""

import json
import runpy
import sys
from importlib import resources
from pathlib import Path
from types import ModuleType

import pytest
import yaml
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from cloth_sim_ros.messages import message_definition
from cloth_sim_ros.node_parameters import PARAMETERS, check, scene_parameters, worker_settings
from cloth_sim_ros.scene_inputs import SceneParameters
from cloth_sim_ros.topics import BODY, BODY_MARKER, DIAGNOSTICS, GARMENT, PATTERN, REPORT
from cloth_sim_ros.worker import WorkerSettings

PACKAGE = Path(str(resources.files("cloth_sim_ros")))


def test_parameter_file_holds_all_parameters_with_their_default_values():
    content = yaml.safe_load((PACKAGE / "config" / "cloth_sim.yaml").read_text())
    assert content["/**/cloth_sim"]["ros__parameters"] == {
        parameter.name: parameter.default for parameter in PARAMETERS
    }


def test_default_parameters_are_those_of_the_worker():
    values = {parameter.name: parameter.default for parameter in PARAMETERS}
    check(values)
    assert scene_parameters(values) == SceneParameters()
    assert worker_settings(values) == WorkerSettings()


def test_view_shows_what_the_node_sends():
    content = yaml.safe_load((PACKAGE / "rviz" / "cloth_sim.rviz").read_text())["Visualization Manager"]
    markers = [display for display in content["Displays"] if display["Class"] == "rviz_default_plugins/Marker"]
    assert [display["Topic"]["Value"] for display in markers] == [
        topic.resolve("cloth_sim") for topic in (BODY_MARKER, GARMENT)
    ]
    assert all(display["Topic"]["Durability Policy"] == "Transient Local" for display in markers)
    assert content["Global Options"]["Fixed Frame"] == SceneParameters().frame_id


class Recorded:
    """Stands for any class of `launch`: keeps what it was made with."""

    def __init__(self, *arguments, **options):
        self.arguments, self.options = arguments, options


def test_launch_file_starts_the_node_with_files_that_exist(monkeypatch):
    """`launch` is not on PyPI; its classes are replaced by ones that keep their arguments."""
    names = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument"],
        "launch.conditions": ["IfCondition"],
        "launch.substitutions": ["LaunchConfiguration", "NotEqualsSubstitution"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
    }
    for name, classes in names.items():
        module = ModuleType(name)
        for found in classes:
            setattr(module, found, type(found, (Recorded,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS"):
        monkeypatch.delenv(name, raising=False)
    description = runpy.run_path(str(PACKAGE / "launch" / "cloth_sim.launch.py"))["generate_launch_description"]()
    actions = description.arguments[0]
    declared = {action.arguments[0]: action.options for action in actions if "default_value" in action.options}
    assert Path(declared["params_file"]["default_value"]).is_file()
    assert Path(declared["rviz_config"]["default_value"]).is_file()
    simulator, viewer, transform = (action.options for action in actions if "executable" in action.options)
    assert (simulator["package"], simulator["executable"]) == ("cloth_sim_ros", "cloth_sim_node")
    assert Path(viewer["additional_env"]["FASTRTPS_DEFAULT_PROFILES_FILE"]) == PACKAGE / "dds" / "fastdds.xml"
    assert viewer["condition"].arguments[0].arguments == ("rviz",)
    assert transform["arguments"][::2] == ["--x", "--y", "--z", "--yaw", "--frame-id", "--child-frame-id"]
    assert transform["condition"].arguments[0].arguments[0].arguments == ("parent_frame",)
    parameters_file, parameters = simulator["parameters"]
    used = [simulator["namespace"], parameters_file, *parameters.values(), viewer["arguments"][1]]
    used += transform["arguments"][1::2]
    assert {value.arguments[0] for value in used} == set(declared) - {"rviz"}
    # The frame of the view, of the parameter and of the transform are one.
    assert declared["frame_id"]["default_value"] == SceneParameters().frame_id


def test_foxglove_layout_shows_what_the_node_sends():
    content = json.loads((PACKAGE / "foxglove" / "cloth_sim.json").read_text())
    panels, waiting = set(), [content["layout"]]
    while waiting:
        part = waiting.pop()
        if isinstance(part, str):
            panels.add(part)
        else:
            waiting += [part["first"], part["second"]]
    assert panels == set(content["configById"])
    view = next(config for name, config in content["configById"].items() if name.startswith("3D!"))
    assert view["followTf"] == SceneParameters().frame_id
    assert set(view["topics"]) == {topic.resolve() for topic in (BODY_MARKER, GARMENT)}
    assert all(topic["visible"] for topic in view["topics"].values())
    others = {config["topicPath"] for config in content["configById"].values() if "topicPath" in config}
    assert others == {REPORT.resolve()}


@pytest.mark.parametrize("topic", [PATTERN, BODY, GARMENT, DIAGNOSTICS])
def test_message_definitions_are_those_of_jazzy(topic):
    found = get_types_from_msg(message_definition(topic.message_type), topic.message_type)
    jazzy = get_typestore(Stores.ROS2_JAZZY).fielddefs
    assert topic.message_type in found
    assert {name: fields for name, (_, fields) in found.items()} == {name: jazzy[name][1] for name in found}


def test_message_definitions_come_with_their_licence():
    text = (PACKAGE / "data" / "message_definitions" / "LICENSE.txt").read_text()
    assert "Apache License" in text
    assert "github.com/ros2/common_interfaces" in text
