"""The package as users get it: a wheel from pip, a ROS package from colcon, and a core that keeps clear of ROS."""

import ast
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest
from catkin_pkg.package import parse_package

ROOT = Path(__file__).parents[1]
SHARED_FILES = (
    "package.xml",
    "launch/cloth_sim.launch.py",
    "config/cloth_sim.yaml",
    "rviz/cloth_sim.rviz",
    "dds/fastdds.xml",
    "foxglove/cloth_sim.json",
)
PACKAGE_DATA = (
    "cloth_core/data/patterns/tshirt.json",
    "cloth_core/data/bodies/young.ply",
    "cloth_core/data/fabrics.json",
    "cloth_core/py.typed",
    "cloth_sim_ros/data/message_definitions/visualization_msgs.Marker.msg",
    "cloth_sim_ros/py.typed",
)
ROS_PACKAGES = re.compile(r"(rclpy|rcl_\w+|ament_\w+|rosidl_\w+|builtin_interfaces|launch(_ros)?|\w+_(msgs|srvs))$")
# These talk to a ROS graph; everything else works without ROS.
TALKS_TO_ROS = {
    "delivery.py",
    "demo.py",
    "node.py",
    "play.py",
    "rclpy_topics.py",
    "unlocked_publisher.py",
    "cloth_sim.launch.py",
}


def run(*command: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    result = subprocess.run(
        [str(part) for part in command],
        env={**os.environ, **environment},
        cwd=ROOT.anchor,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, f"{command}\n{result.stdout}\n{result.stderr}"
    return result


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what is needed to build, so that nothing is left in the repository."""
    copy = tmp_path_factory.mktemp("source") / "cloth_sim_ros"
    copy.mkdir()
    for name in ("LICENSE", "README.md", "package.xml", "pyproject.toml", "setup.cfg", "setup.py"):
        shutil.copy(ROOT / name, copy)
    for name in ("cloth_core", "cloth_sim_ros", "resource"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    return copy


@pytest.fixture(scope="module")
def pip_installation(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Prefix into which pip has installed the wheel that it built; nothing is fetched."""
    wheels, prefix = tmp_path_factory.mktemp("wheels"), tmp_path_factory.mktemp("pip")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check")
    run(*pip, "wheel", "--quiet", "--no-deps", "--no-index", "--no-build-isolation", "-w", wheels, source)
    (wheel,) = wheels.glob("*.whl")
    run(*pip, "install", "--quiet", "--no-deps", "--no-index", "--ignore-installed", "--prefix", prefix, wheel)
    return prefix


@pytest.fixture(scope="module")
def colcon_installation(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Prefix of the package that `colcon build` has installed."""
    work = tmp_path_factory.mktemp("colcon")
    folders = ("--build-base", work / "build", "--install-base", work / "install")
    colcon = Path(sys.executable).with_name("colcon")
    run(colcon, "--log-base", work / "log", "build", "--base-paths", source, *folders)
    return Path(work / "install" / "cloth_sim_ros")


def python_path(prefix: Path) -> Path:
    (path,) = {site.parent for site in prefix.rglob("cloth_core") if site.is_dir()}
    return path


@pytest.fixture(params=["pip_installation", "colcon_installation"])
def installation(request: pytest.FixtureRequest) -> Path:
    prefix: Path = request.getfixturevalue(request.param)
    return prefix


def test_pip_puts_the_executables_into_bin(pip_installation: Path) -> None:
    names = {path.name for path in (pip_installation / "bin").iterdir()}
    assert names == {"cloth-sim", "cloth_sim_node"}
    assert not (pip_installation / "lib" / "cloth_sim_ros").exists()


def test_colcon_puts_the_executables_where_ros2_run_looks(colcon_installation: Path) -> None:
    executables = {path.name: path for path in (colcon_installation / "lib" / "cloth_sim_ros").iterdir()}
    assert set(executables) == {"cloth-sim", "cloth_sim_node"}
    assert all(os.access(path, os.X_OK) for path in executables.values())


def test_shared_files_are_those_of_the_source(installation: Path) -> None:
    share = installation / "share" / "cloth_sim_ros"
    for name in SHARED_FILES:
        original = ROOT / name if name == "package.xml" else ROOT / "cloth_sim_ros" / name
        assert (share / name).read_bytes() == original.read_bytes()


def test_resource_index_names_the_package(installation: Path) -> None:
    assert (installation / "share/ament_index/resource_index/packages/cloth_sim_ros").is_file()


def test_package_data_is_installed(installation: Path) -> None:
    site = python_path(installation)
    for name in PACKAGE_DATA:
        assert (site / name).read_bytes() == (ROOT / name).read_bytes()


def test_all_modules_are_installed(installation: Path) -> None:
    site = python_path(installation)
    for package in ("cloth_core", "cloth_sim_ros"):
        names = {path.name for path in (ROOT / package).glob("*.py")}
        assert {path.name for path in (site / package).glob("*.py")} == names


def test_installed_command_runs(installation: Path) -> None:
    site = python_path(installation)
    (command,) = (path for path in installation.rglob("cloth-sim") if path.parent.name in ("bin", "cloth_sim_ros"))
    assert "drape" in run(command, "--help", PYTHONPATH=str(site)).stdout
    code = "import cloth_core, cloth_sim_ros; print(cloth_core.__file__, cloth_sim_ros.__file__)"
    assert run(sys.executable, "-c", code, PYTHONPATH=str(site)).stdout.count(str(site)) == 2
    assert "dress, rectangle" in failing(command, site)


def failing(command: Path, site: Path) -> str:
    """What the installed command says about a pattern that does not exist; it has to find its data for that."""
    result = subprocess.run(
        [str(command), "explain", "no_such_pattern"],
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2
    return result.stderr


def test_package_xml_is_valid_and_agrees_with_setup_py(pip_installation: Path) -> None:
    package = parse_package(str(ROOT / "package.xml"))
    assert package.package_format == 3
    assert [export.tagname for export in package.exports] == ["build_type"]
    (metadata,) = importlib.metadata.distributions(name="cloth_sim_ros", path=[str(python_path(pip_installation))])
    assert (package.name, package.version) == (metadata.name, metadata.version)
    assert package.description == metadata.metadata["Summary"]
    assert package.licenses == [metadata.metadata["License"] or metadata.metadata["License-Expression"]]


def test_package_xml_names_every_message_package_that_is_imported() -> None:
    declared = {element.text for element in ElementTree.parse(ROOT / "package.xml").iter("exec_depend")}
    imported = {root for path in sources("cloth_sim_ros") for root in imports(path) if ROS_PACKAGES.match(root)}
    assert imported
    assert imported <= declared


def test_every_requirement_is_constrained(pip_installation: Path) -> None:
    (metadata,) = importlib.metadata.distributions(name="cloth_sim_ros", path=[str(python_path(pip_installation))])
    required = {normalised(requirement) for requirement in metadata.requires or []}
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    constrained = {normalised(line) for line in lines if line and not line.startswith("#")}
    assert required
    assert required <= constrained


def normalised(requirement: str) -> str:
    """Name of a distribution in its comparable form (PEP 503)."""
    match = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert match is not None
    return re.sub(r"[-_.]+", "-", match.group()).lower()


def sources(*folders: str) -> Iterator[Path]:
    for folder in folders:
        yield from (path for path in (ROOT / folder).rglob("*.py") if "__pycache__" not in path.parts)


def imports(path: Path) -> set[str]:
    """First parts of the names of all modules that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            found.add(node.module.partition(".")[0])
    return found


def test_core_and_its_tests_import_nothing_of_ros() -> None:
    for path in sources("cloth_core", "tests/core"):
        assert not [root for root in imports(path) if ROS_PACKAGES.match(root)], path
    for path in sources("cloth_core"):
        assert "cloth_sim_ros" not in imports(path), path


def test_only_what_talks_to_a_graph_imports_ros() -> None:
    talking = {path.name for path in sources("cloth_sim_ros") if any(map(ROS_PACKAGES.match, imports(path)))}
    assert talking == TALKS_TO_ROS
