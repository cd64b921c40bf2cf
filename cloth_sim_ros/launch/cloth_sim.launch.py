"""Starts the simulator: ``ros2 launch cloth_sim_ros cloth_sim.launch.py rviz:=true``.

Several side by side: give each a ``namespace``. To put the scene somewhere into the frames of a robot, name the frame
to which it belongs, and where it is in that: ``parent_frame:=base_link x:=0.8 yaw:=1.57``.
"""

import os
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, NotEqualsSubstitution
from launch_ros.actions import Node

from cloth_sim_ros.delivery import configure_fast_dds

# Beside this file in the source tree, in share/ and in site-packages alike.
PACKAGE = Path(__file__).parent.parent

POSE = {"x": "m", "y": "m", "z": "m", "yaw": "rad"}


def generate_launch_description() -> LaunchDescription:
    """The node, its arguments, and rviz2 with a view that shows body and garment."""
    environment = dict(os.environ)
    configure_fast_dds(environment)
    # With the transports of the node, who joins it holds up nobody for long.
    transports = {name: value for name, value in environment.items() if name not in os.environ}
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node"),
            DeclareLaunchArgument(
                "params_file",
                default_value=str(PACKAGE / "config" / "cloth_sim.yaml"),
                description="YAML file with the node's parameters",
            ),
            DeclareLaunchArgument("rviz", default_value="false", description="Whether to open rviz2"),
            DeclareLaunchArgument(
                "rviz_config",
                default_value=str(PACKAGE / "rviz" / "cloth_sim.rviz"),
                description="View that rviz2 opens with",
            ),
            DeclareLaunchArgument(
                "parent_frame", default_value="", description="Frame in which frame_id stands still; empty for none"
            ),
            DeclareLaunchArgument("frame_id", default_value="map", description="The node's parameter frame_id"),
            *(
                DeclareLaunchArgument(name, default_value="0.0", description=f"Of frame_id in parent_frame [{unit}]")
                for name, unit in POSE.items()
            ),
            Node(
                package="cloth_sim_ros",
                executable="cloth_sim_node",
                name="cloth_sim",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("params_file"), {"frame_id": LaunchConfiguration("frame_id")}],
                output="screen",
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=LaunchConfiguration("namespace"),
                arguments=["-d", LaunchConfiguration("rviz_config")],
                additional_env=transports,
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
            Node(
                package="tf2_ros",
                executable="static_transform_publisher",
                namespace=LaunchConfiguration("namespace"),
                arguments=[
                    *(part for name in POSE for part in (f"--{name}", LaunchConfiguration(name))),
                    *("--frame-id", LaunchConfiguration("parent_frame")),
                    *("--child-frame-id", LaunchConfiguration("frame_id")),
                ],
                additional_env=transports,
                condition=IfCondition(NotEqualsSubstitution(LaunchConfiguration("parent_frame"), "")),
            ),
        ]
    )
