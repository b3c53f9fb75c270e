"""The operating system account that a command runs under."""

import os
import pwd
import socket


def operating_system_account_name() -> str:
    """Return the login name of this process. Environment variables are not trusted."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return f"uid-{os.getuid()}"


def account_at_host() -> str:
    """Return account and host name, for the audit."""
    return f"{operating_system_account_name()}@{socket.gethostname()}"[:64]
