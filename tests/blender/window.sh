#!/bin/sh
# SPDX-License-Identifier: GPL-3.0-or-later
# window.sh ARGUMENTS...: Blender with these arguments, its window filling a virtual screen of the size SCREEN, such as 1280x800.
# Runs inside the Debian root.
mkfifo /tmp/display
Xvfb -displayfd 3 -screen 0 "${SCREEN}x24" -fbdir /tmp -nocursor -nolisten tcp 3>/tmp/display >xvfb.log 2>&1 &
read -r number </tmp/display
export DISPLAY=":$number"
# no title bars and no borders: what Blender says of places in its window then holds for the screen
echo '<openbox_config xmlns="http://openbox.org/3.4/rc"><theme><keepBorder>no</keepBorder></theme>
<applications><application class="*"><decor>no</decor></application></applications></openbox_config>' >/tmp/openbox.xml
openbox --config-file /tmp/openbox.xml >/dev/null 2>&1 &
exec blender --window-geometry 0 0 "${SCREEN%x*}" "${SCREEN#*x}" --enable-event-simulate "$@"
