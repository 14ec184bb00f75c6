"""A network cable that can be pulled: cable.py FROM TO. Relays one PostgreSQL socket to another until it is killed."""

from __future__ import annotations

import socket
import sys
from contextlib import suppress
from threading import Thread


def pump(source: socket.socket, target: socket.socket) -> None:
    with suppress(OSError):
        while content := source.recv(65536):
            target.sendall(content)
    for end in (source, target):
        with suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)


def relay(near: socket.socket, path: str) -> None:
    far = socket.socket(socket.AF_UNIX)
    try:
        far.connect(path)
    except OSError:
        near.close()
        return
    pumps = [Thread(target=pump, args=ends, daemon=True) for ends in ((near, far), (far, near))]
    for one in pumps:
        one.start()
    for one in pumps:
        one.join()
    near.close()
    far.close()


if __name__ == "__main__":
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(sys.argv[1])
        listening.listen()
        while True:
            Thread(target=relay, args=(listening.accept()[0], sys.argv[2]), daemon=True).start()
