# SPDX-License-Identifier: GPL-3.0-or-later
"""Run pytest with these arguments and end the process at once, with its exit code.

For Blender 4.2 as a module, which crashes while Python shuts down as soon as anybody has registered an operator.
"""
import os
import sys

import pytest

code = pytest.main(sys.argv[1:])
sys.stdout.flush()
sys.stderr.flush()
os._exit(int(code))
