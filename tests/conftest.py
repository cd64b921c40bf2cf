"""Random examples are the same in every run, none fails because the machine is busy; what runs in one process."""

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("suite", deadline=None, derandomize=True)
settings.load_profile("suite")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """With `-n`, tests of one file share a process, and so do all that talk over DDS, in one domain."""
    for item in items:
        file = Path(item.path)
        over_dds = file.parent.name == "ros"
        item.add_marker(pytest.mark.xdist_group("ros" if over_dds else file.stem))
