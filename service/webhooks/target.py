"""Where a webhook may go: never into a private network, whatever its name resolves to."""

from __future__ import annotations

import ipaddress
import socket
from dataclasses import dataclass
from urllib.parse import urlsplit

Address = ipaddress.IPv4Address | ipaddress.IPv6Address
Network = ipaddress.IPv4Network | ipaddress.IPv6Network

LONGEST_URL = 2000


class ForbiddenTarget(Exception):
    """str() says why this URL gets no webhooks."""


@dataclass(frozen=True)
class Target:
    """A URL taken apart, with the address that was checked and is to be connected to."""

    secure: bool
    host: str
    port: int
    path: str
    address: str


def parse(url: str) -> tuple[bool, str, int, str]:
    """(https?, host, port, path) of a URL that could take webhooks."""
    if len(url) > LONGEST_URL or any(ord(character) <= 32 for character in url):
        raise ForbiddenTarget("the URL is too long or has blanks in it")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise ForbiddenTarget(f"the URL cannot be read: {error}") from error
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise ForbiddenTarget("the URL is neither http nor https")
    if parts.username or parts.password:
        raise ForbiddenTarget("the URL holds credentials")
    secure = parts.scheme == "https"
    path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    return secure, parts.hostname, port or (443 if secure else 80), path


def resolve(url: str, allowed: tuple[str, ...]) -> Target:
    """The target with a checked address; to be connected to by that address, not by the name.

    allowed: networks in which private addresses are fine.
    """
    secure, host, port, path = parse(url)
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise ForbiddenTarget(f"{host} cannot be resolved") from error
    networks = [ipaddress.ip_network(network) for network in allowed]
    addresses = [ipaddress.ip_address(str(entry[4][0]).partition("%")[0]) for entry in found]
    for address in addresses:
        if not _is_public(address) and not any(_within(address, n) for n in networks):
            raise ForbiddenTarget(f"{host} is {address}, which is not a public address")
    return Target(secure, host, port, path, str(addresses[0]))


def _is_public(address: Address) -> bool:
    inner = getattr(address, "ipv4_mapped", None) or getattr(address, "sixtofour", None)
    if inner is not None and not inner.is_global:
        return False
    return address.is_global and not address.is_multicast


def _within(address: Address, network: Network) -> bool:
    return address.version == network.version and address in network
