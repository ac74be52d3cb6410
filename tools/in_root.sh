#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# in_root.sh ROOT WORK COMMAND...: runs a command in a folder of blender_root.sh, as in a machine of its own.
#
# WORK is its working folder, /mnt, and holds its home; the root is read-only, there is no network, and everything that the
# command starts and mounts goes with it.  FASTGS_BINDS may hold lines SOURCE=TARGET: folders of this machine that the command finds,
# read-only, in these folders of WORK.
set -euo pipefail
# shellcheck disable=SC2016
exec unshare --mount --pid --net --fork --kill-child sh -ec '
    root=$1 work=$2; shift 2
    mount --bind "$root" "$root"
    mount -o remount,bind,ro "$root"
    mount -t proc proc "$root/proc"
    mount --rbind /dev "$root/dev"
    mount -t tmpfs tmpfs "$root/tmp"
    mount -t tmpfs tmpfs "$root/run"
    mount --bind "$work" "$root/mnt"
    mkdir -p "$work/home" "$work/tmp"
    echo "${FASTGS_BINDS:-}" | while IFS="=" read -r source target; do
        [ -z "$source" ] && continue
        mount --bind "$source" "$root/mnt/$target"
        mount -o remount,bind,ro "$root/mnt/$target"
    done
    exec chroot "$root" env -i -C /mnt PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/mnt/home TMPDIR=/mnt/tmp XDG_RUNTIME_DIR=/run LANG=C.UTF-8 \
        LIBGL_ALWAYS_SOFTWARE=1 PYTHONDONTWRITEBYTECODE=1 "$@"' _ "$@"
