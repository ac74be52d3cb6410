#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# blender_root.sh SUITE: prints the folder of a Debian system with that release's Blender, Xvfb and Mesa's software OpenGL.
# blender_root.sh wine: the same with Wine, which runs Windows' programs, and without Blender.
# blender_root.sh --possible: only says whether this machine can make such folders.
# blender_root.sh --tools: only installs what makes them.
#
# trixie has Blender 4.3, sid the newest that Debian packages.  The folder is made once (two minutes, up to 1.8 GB) and kept, with a
# packed copy of it, under $FASTGS_BLENDER_ROOTS, or else fastgs-blender/roots in the user's cache; where only the packed copy is
# there it is unpacked (ten seconds).  Packages come from the Debian mirror that this machine's apt uses.
#
# The exit status is 3 where this kind of machine cannot make such folders, and 4 where it can and something failed; either way the
# reason is the one line on standard error.
set -euo pipefail

suite=${1:?suite, --possible or --tools}
roots=${FASTGS_BLENDER_ROOTS:-${XDG_CACHE_HOME:-$HOME/.cache}/fastgs-blender/roots}
# Debian's blender names only what it links; its add-ons import the Python modules.
packages=(
    blender xvfb x11-utils openbox libgl1-mesa-dri libglx-mesa0 libegl1
    mesa-vulkan-drivers python3-numpy python3-requests python3-zstandard python3-cattr python3-fastjsonschema fonts-dejavu-core procps
)
release=$suite program=blender
case $suite in
    trixie) packages+=(chromium firefox-esr) ;;  # open web pages
    wine) release=trixie program=wine packages=(wine wine64 xvfb xauth libgl1-mesa-dri mesa-vulkan-drivers libvulkan1) ;;  # with fewer it hangs
esac
recipe=2  # to be raised when something below changes what is in a root
digest=$(echo "$recipe $suite ${packages[*]}" | sha256sum | cut -c1-12)
root=$roots/$suite-$digest
archive=$root.tar.zst
log=$roots/$suite.log
case $suite in
    --*) what="No Blender of Debian can be set up here" ;;
    *) what="No Blender of Debian $suite here" ;;
esac

leave() { # status, reason
    rm -rf "$root.part" "${probe:-}" 2>/dev/null || true
    echo "$what: $2." >&2
    exit "$1"
}
cannot() { leave 3 "$1"; }
failed() { leave 4 "$1"; }

namespaced() { # nothing that the command mounts or starts outlives it
    unshare --mount --pid --fork --kill-child "$@"
}

inside() {
    # shellcheck disable=SC2016
    namespaced sh -c '
        root=$1; shift
        mount -t proc proc "$root/proc"
        mount --rbind /dev "$root/dev"
        exec chroot "$root" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8 DEBIAN_FRONTEND=noninteractive \
            http_proxy="${http_proxy:-}" https_proxy="${https_proxy:-}" no_proxy="${no_proxy:-}" "$@"' _ "$root.part" "$@"
}

mirror() {
    cat /etc/apt/sources.list /etc/apt/sources.list.d/*.list /etc/apt/sources.list.d/*.sources 2>/dev/null |
        sed -nE 's/^(URIs:|deb(-src)?( \[[^]]*\])?) +(https?:[^ ]*\/debian)\/?( .*)?$/\4/p' | head -n 1
}

lacking() { # the tools that are not installed
    for tool in debootstrap zstd; do
        command -v $tool >/dev/null || echo $tool
    done
}

tools() { # one at a time on this machine: two roots that begin together do not run apt beside each other
    local missing
    exec 8>"$roots/tools.lock"
    flock 8
    missing=$(lacking | xargs)
    if [[ -n $missing ]]; then
        # shellcheck disable=SC2086
        { apt-get update -qq && apt-get install -y -qq --no-install-recommends -o DPkg::Lock::Timeout=600 $missing; } \
            >"$roots/tools.log" 2>&1 || failed "$missing could not be installed (see $roots/tools.log)"
    fi
    exec 8>&-
}

build() {
    namespaced debootstrap --variant=minbase "$release" "$root.part" "$from" >>"$log" 2>&1 ||
        failed "debootstrap failed (see $log)"
    printf '#!/bin/sh\nexit 101\n' >"$root.part/usr/sbin/policy-rc.d"
    chmod +x "$root.part/usr/sbin/policy-rc.d"
    printf 'force-unsafe-io\npath-exclude=/usr/share/%s/*\n' doc >"$root.part/etc/dpkg/dpkg.cfg.d/lean"
    printf 'path-exclude=/usr/share/%s/*\n' man locale >>"$root.part/etc/dpkg/dpkg.cfg.d/lean"
    # A mirror that stands still serves a rolling release whose signed date has run out; the signature itself is checked.
    [[ $suite != sid ]] || echo 'Acquire::Check-Valid-Until "false";' >"$root.part/etc/apt/apt.conf.d/99still"
    for file in /etc/apt/apt.conf.d/*proxy* /etc/resolv.conf; do
        [[ ! -f $file ]] || cp -L "$file" "$root.part/${file#/}"
    done
    { inside apt-get update -qq && inside apt-get install -y -qq --no-install-recommends "${packages[@]}" && inside apt-get clean; } \
        >>"$log" 2>&1 || failed "its packages could not be installed (see $log)"
    # Debian does not compile what Blender itself starts, and nothing can be written to a root: each start would compile it, for two seconds.
    inside python3 -m compileall -q /usr/share/blender >>"$log" 2>&1 || true  # templates do not compile
    rm -rf "$root.part"/var/lib/apt/lists/* "$root.part/etc/apt/apt.conf.d/"*proxy* "$root.part/etc/resolv.conf"
}

[[ $(id -u) == 0 ]] || cannot "only root can make and enter its folder"
namespaced true 2>/dev/null || cannot "this machine does not let root make namespaces"
mkdir -p "$roots" 2>/dev/null && [[ -w $roots ]] || cannot "nothing can be written to $roots"
from=$(mirror) || true
if [[ ! -d $root && ! -f $archive ]]; then
    [[ -n $from ]] || cannot "the apt sources name no Debian mirror"
    [[ -z $(lacking) ]] || command -v apt-get >/dev/null ||
        cannot "$(lacking | xargs) is not installed, and there is no apt-get to install it"
fi
case $suite in
    --possible) exit 0 ;;
    --tools) tools && exit 0 ;;
esac
exec 9>"$roots/$suite.lock"
flock 9
if [[ ! -d $root ]]; then
    : >"$log"
    tools
    rm -rf "$root.part"
    if [[ -f $archive ]]; then
        mkdir "$root.part"
        tar --zstd -xf "$archive" -C "$root.part" || failed "$archive could not be unpacked"
    else
        build
        find "$roots" -maxdepth 1 -name "$suite-*" ! -name "$suite-$digest*" -exec rm -rf {} +
        tar --zstd -cf "$archive.part" -C "$root.part" . && mv "$archive.part" "$archive"
    fi
    mv "$root.part" "$root"
fi
probe=$(mktemp -d)
"$(dirname "$0")/in_root.sh" "$root" "$probe" "$program" --version >"$probe/said" 2>&1 ||
    failed "it does not start ($(tail -n 1 "$probe/said"))"
rm -rf "$probe"
echo "$root"
