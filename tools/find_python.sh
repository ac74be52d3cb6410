#!/bin/sh
# SPDX-License-Identifier: GPL-3.0-or-later
# find_python.sh 3.11: prints the path of a Python of that version that can make virtual environments.
# It looks at $PYTHON, the PATH, pyenv, Homebrew, python.org's macOS framework and uv, and believes only what runs:
# version managers put commands on the PATH that answer with an error.
version=$1

works() {
    [ -n "$1" ] && "$1" -c "
import sys, venv, ensurepip
sys.exit('%d.%d' % sys.version_info[:2] != '$version')" >/dev/null 2>&1
}

try() {
    if works "$1"; then
        "$1" -c "import os, sys; print(os.path.realpath(sys.executable) if sys.prefix == sys.base_prefix else sys.executable)"
        exit 0
    fi
}

try "$PYTHON"
old_ifs=$IFS
IFS=:
for folder in $PATH; do
    try "$folder/python$version"
    try "$folder/python3"
done
IFS=$old_ifs
for python in "${PYENV_ROOT:-$HOME/.pyenv}"/versions/"$version"*/bin/python /opt/homebrew/bin/python"$version" \
    /usr/local/bin/python"$version" /Library/Frameworks/Python.framework/Versions/"$version"/bin/python3; do
    try "$python"
done
if command -v uv >/dev/null 2>&1; then
    try "$(uv python find --no-python-downloads "$version" 2>/dev/null)"
fi
exit 1
