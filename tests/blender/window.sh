#!/bin/sh
# SPDX-License-Identifier: GPL-3.0-or-later
# window.sh ARGUMENTS...: Blender with these arguments, its window filling a virtual screen.  Runs inside the Debian root.
mkfifo /tmp/display
Xvfb -displayfd 3 -screen 0 1280x800x24 -nolisten tcp 3>/tmp/display >xvfb.log 2>&1 &
read -r number </tmp/display
export DISPLAY=":$number"
openbox >/dev/null 2>&1 &
exec blender --window-geometry 0 0 1280 800 --enable-event-simulate "$@"
