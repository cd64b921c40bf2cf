"""Packaging of both Python packages, for pip and for colcon (ament_python). All metadata is here and only here."""

from glob import glob
from pathlib import Path

from setuptools import setup

NAME = "cloth_sim_ros"

RUNTIME = [
    "click>=8.1",
    "embreex>=2.17.7",
    "imageio>=2.31",
    "imageio-ffmpeg>=0.5",
    "mcap>=1.5",
    "numba>=0.59",
    "numpy>=1.26",
    "pillow>=10.0",
    "rich>=13.0",
    "scipy>=1.11.4",
    "shapely>=2.1",
    "trimesh>=4.0",
    "zstandard>=0.22",
]
ROS = ["pyyaml>=6.0", "ros-jazzy-common-interfaces>=5.3.6", "ros-jazzy-rclpy[fastrtps]>=7.1.6"]
TEST = [
    # The suite as such.
    "hypothesis>=6.100",
    "pytest>=8.0",
    "pytest-xdist>=3.5",
    # Independent truths: other people's readers of logs, another DDS stack, crossings, curves, and what trimesh needs.
    "cyclonedds>=11.0; platform_machine == 'x86_64'",  # has wheels for nothing else
    "libigl>=2.6",
    "mcap-ros2-support>=0.5",
    "rosbags>=0.10",
    "rtree>=1.0",
    "svgpathtools>=1.6",
    # `colcon build` without apt: the smallest set that builds an ament_python package and shows what failed.
    "colcon-core>=0.18",
    "colcon-output>=0.2.13",
    "colcon-ros>=0.5",
    "setuptools>=64",
]
PLOTS = ["matplotlib>=3.7"]
LINT = ["mypy>=1.10", "ruff>=0.5"]

setup(
    name=NAME,
    version="0.1.0",
    description="Garment simulation by particles and springs: sewing pattern and body in, cloth at rest and a log out",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    author="cloth_sim_ros contributors",
    maintainer="cloth_sim_ros contributors",
    maintainer_email="cloth_sim_ros@example.com",
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=["cloth_core", "cloth_sim_ros"],
    package_data={
        "cloth_core": ["py.typed", "data/**/*"],
        "cloth_sim_ros": [
            "py.typed",
            "data/**/*",
            "launch/*",
            "config/*",
            "rviz/*",
            "security/*",
            "foxglove/*",
            "dds/*",
        ],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *(
            (f"share/{NAME}/{folder}", glob(f"{NAME}/{folder}/*"))
            for folder in ("launch", "config", "rviz", "security", "foxglove", "dds")
        ),
    ],
    zip_safe=False,
    install_requires=RUNTIME,
    extras_require={"ros": ROS, "plots": PLOTS, "test": [*TEST, *PLOTS], "lint": LINT},
    entry_points={
        "console_scripts": [
            "cloth-sim = cloth_sim_ros.command_line:main",
            "cloth_sim_node = cloth_sim_ros.node:main",
        ]
    },
)
