# SPDX-License-Identifier: GPL-3.0-or-later
"""What all rings share."""
import os

import pytest


def pytest_runtest_setup(item):
    if os.name == "nt" and item.get_closest_marker("posix"):
        pytest.skip("Windows has not what this needs")
