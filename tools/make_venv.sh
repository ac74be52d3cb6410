#!/bin/sh
# SPDX-License-Identifier: GPL-3.0-or-later
# make_venv.sh FOLDER PYTHON_VERSION BPY_VERSION [EXTRAS]: a virtual environment with this project, its development tools, other
# extras of pyproject.toml and Blender as a module, if BPY_VERSION is not empty.  The stamp FOLDER/ready is written last, so an interrupted
# installation starts anew.
set -e
folder=$1 python_version=$2 bpy_version=$3 extras=dev${4:+,$4}
log=$folder/install.log

if ! python=$("$(dirname "$0")/find_python.sh" "$python_version"); then
    echo "Python $python_version with its venv module was not found: bpy $bpy_version exists for that version alone." >&2
    echo "Install it (for example with your system's packages, pyenv or uv), or name it: make PYTHON=/path/to/python$python_version" >&2
    exit 1
fi
if ! "$folder/bin/python" -c "import pip" >/dev/null 2>&1; then
    rm -rf "$folder"
    "$python" -m venv "$folder"
fi
rm -f "$folder/ready"
echo "Installing ${bpy_version:+Blender $bpy_version as a module and }the project into $folder (once; 400 MB, with training 1 GB) ..."
sed -n 's/^\([^#]*==[^ ]*\).*/\1/p' tools/wheels.txt >"$folder/wheels.txt"  # what is tested is what the zips contain
if ! "$folder/bin/python" -m pip install --disable-pip-version-check -c tools/constraints.txt -c "$folder/wheels.txt" \
    -e ".[$extras]" ${bpy_version:+"bpy==$bpy_version"} >"$log" 2>&1; then
    tail -n 15 "$log" >&2
    echo "The installation into $folder failed; the whole log is $log" >&2
    echo "If pip found no bpy $bpy_version: Blender's own package index has it as well; set PIP_EXTRA_INDEX_URL to its address." >&2
    exit 1
fi
touch "$folder/ready"
