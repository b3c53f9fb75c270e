"""Takes a port of this machine, and tells whether others reach it."""

import ipaddress
import socket


def listening_socket(host: str, port: int, queue: int) -> socket.socket:
    """A TCP socket that listens; `port` 0: any that is free. Raises OSError.

    A server that starts anew gets the port at once, though old connections linger.
    """
    (family, *_, address), *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    made = socket.socket(family, socket.SOCK_STREAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(address)
        made.listen(queue)
    except OSError:
        made.close()
        raise
    return made


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches this address, or name."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
