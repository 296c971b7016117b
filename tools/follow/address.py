"""Where a server listens."""

from __future__ import annotations

from polemap.drivelog.errors import ConfigError

LOOPBACK = "127.0.0.1"


def parse_address(text: str) -> tuple[str, int]:
    """`[HOST:]PORT`; without a host this computer alone can connect.

    Raises:
        ConfigError: no port between 0 and 65535.
    """
    host, colon, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if (colon and not host) or not port.isdecimal() or int(port) > 65535:
        raise ConfigError(f"--serve {text[:60]}: expected [HOST:]PORT, such as 8765")
    return host or LOOPBACK, int(port)
