"""Starts the simulator, with rviz2 on request: ``ros2 launch cloth_sim_ros cloth_sim.launch.py rviz:=true``."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# Beside this file in the source tree, in share/ and in site-packages alike.
PACKAGE = Path(__file__).parent.parent


def generate_launch_description() -> LaunchDescription:
    """The node, its arguments, and rviz2 with a view that shows body and garment."""
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
            Node(
                package="cloth_sim_ros",
                executable="cloth_sim_node",
                name="cloth_sim",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("params_file")],
                output="screen",
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=LaunchConfiguration("namespace"),
                arguments=["-d", LaunchConfiguration("rviz_config")],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
        ]
    )
