"""The account that a command runs under, as the operating system knows it."""

import os
import pwd
import socket


def login_name() -> str:
    """The login name of this process. Environment variables are not asked: anybody sets them."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return f"uid-{os.getuid()}"


def login() -> str:
    """Account and machine, for the audit."""
    return f"{login_name()}@{socket.gethostname()}"[:64]
