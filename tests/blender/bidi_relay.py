# SPDX-License-Identifier: GPL-3.0-or-later
"""bidi_relay.py PROFILE COMMAND...: runs Firefox on a display of its own, and speaks with it as Chromium is spoken to: over a pipe.

Messages end in a zero byte, come through descriptor 3, and go through descriptor 4.  Firefox itself listens at a WebSocket, which a
process outside of a Debian root does not reach; so this runs inside, in the root's Python, and imports nothing else.
Firefox gives pages no WebGL without a display, so Xvfb is one.
"""
import contextlib
import fcntl
import json
import os
import pathlib
import socket
import struct
import subprocess
import sys
import threading
import time

SET_FLAGS, UP = 0x8914, 0x49
"""SIOCSIFFLAGS, and a loopback that is up and running: in a namespace without a network it is not."""
MASK = b"mask"


def framed(data):
    """A message as a WebSocket's frame: the shortest, and masked by anything but zeros, or Firefox hangs up."""
    size = len(data)
    length = bytes([128 | size]) if size < 126 else struct.pack(">BH", 254, size) if size < 1 << 16 else struct.pack(">BQ", 255, size)
    return b"\x81" + length + MASK + bytes(byte ^ MASK[n % 4] for n, byte in enumerate(data))


def received(stream):
    """Each frame's text of a WebSocket, and whether its message ends there; Firefox masks none."""
    while head := stream.read(2):
        size = head[1]
        if size > 125:
            size = int.from_bytes(stream.read(2 if size == 126 else 8), "big")
        data = stream.read(size)
        if head[0] & 15 < 2:
            yield data, head[0] >> 7


def connected(address):
    """A socket behind the handshake, and the stream of what comes."""
    link = socket.create_connection((address["ws_host"], address["ws_port"]))
    lines = ("GET /session HTTP/1.1", f"Host: {address['ws_host']}:{address['ws_port']}", "Upgrade: websocket", "Connection: Upgrade",
             "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Version: 13", "", "")
    link.sendall("\r\n".join(lines).encode())
    stream = link.makefile("rb")
    while stream.readline().strip():
        pass
    return link, stream


def main():
    profile, *command = sys.argv[1:]
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        fcntl.ioctl(link, SET_FLAGS, struct.pack("16sH22x", b"lo", UP))
    number, said = os.pipe()
    display = subprocess.Popen(["Xvfb", "-displayfd", str(said), "-screen", "0", "1280x1024x24", "-nolisten", "tcp"], pass_fds=[said])
    screen = os.read(number, 9).decode().strip()
    firefox = subprocess.Popen(command, env=os.environ | {"DISPLAY": f":{screen}", "LIBGL_ALWAYS_SOFTWARE": "1"})
    listens = pathlib.Path(profile, "WebDriverBiDiServer.json")
    while firefox.poll() is None and not (listens.exists() and listens.stat().st_size):
        time.sleep(0.05)
    link, stream = connected(json.loads(listens.read_text()))

    def send():
        rest = b""
        while data := os.read(3, 1 << 20):
            *messages, rest = (rest + data).split(b"\0")
            for each in messages:
                link.sendall(framed(each))
        firefox.terminate()

    threading.Thread(target=send, daemon=True).start()
    with contextlib.suppress(OSError):
        for data, last in received(stream):
            answer = data + b"\0" * last
            while answer:
                answer = answer[os.write(4, answer):]
    firefox.terminate()
    firefox.wait()
    display.terminate()
    display.wait()


if __name__ == "__main__":
    main()
