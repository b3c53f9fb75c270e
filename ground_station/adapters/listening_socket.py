"""Opens a listening TCP port and determines whether other machines can reach it."""

import ipaddress
import socket


def open_server_socket(host: str, port: int, backlog: int) -> socket.socket:
    """Open a listening TCP socket; `port` 0: any free port. Raises OSError.

    A restarted server gets the port at once, even while old connections linger (SO_REUSEADDR).
    """
    (address_kind, *_, address), *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    server_socket = socket.socket(address_kind, socket.SOCK_STREAM)
    try:
        server_socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        server_socket.bind(address)
        server_socket.listen(backlog)
    except OSError:
        server_socket.close()
        raise
    return server_socket


def is_loopback_host(host: str) -> bool:
    """Return whether only this machine can reach this address or host name."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
