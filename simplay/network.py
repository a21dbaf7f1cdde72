"""Who may talk to the Moonraker of a played printer: whom one asks for."""

from __future__ import annotations

import fcntl
import ipaddress
import socket
import struct
from collections.abc import Sequence
from typing import NamedTuple

# What holds a port; to be closed
Claim = socket.socket

LOOPBACK = "127.0.0.1"
EVERYWHERE = "0.0.0.0"
_SIOCGIFADDR, _SIOCGIFNETMASK = 0x8915, 0x891B


class AddressError(Exception):
    """An address on which this machine cannot listen."""


class Door(NamedTuple):
    """Where Moonraker listens, and to whom besides its own machine.

    port: or the next that is free. origins: of web pages from elsewhere.
    """

    listen: str = LOOPBACK
    port: int = 7125
    origins: Sequence[str] = ()


def own_networks() -> dict[str, ipaddress.IPv4Network]:
    """The networks of this machine's interfaces, by its address there."""
    found = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[:15])
            try:
                address, mask = (
                    socket.inet_ntoa(
                        fcntl.ioctl(any_socket, what, request)[20:24]
                    )
                    for what in (_SIOCGIFADDR, _SIOCGIFNETMASK)
                )
            except OSError:  # one without an IPv4 address
                continue
            network = ipaddress.ip_network(f"{address}/{mask}", strict=False)
            found[address] = ipaddress.IPv4Network(network)
    return found


def trusted(listen: str) -> list[str]:
    """Who needs no password where Moonraker listens on that address.

    Always this machine; of its networks only those that can reach the address.
    Raises AddressError where it is none of this machine.
    """
    networks = own_networks()
    if listen == EVERYWHERE:
        asked = list(networks.values())
    elif listen in networks:
        asked = [networks[listen]]
    elif ipaddress.ip_address(listen).is_loopback:
        asked = []
    else:
        known = ", ".join([*networks, EVERYWHERE])
        raise AddressError(f"--listen {listen}: not here, only {known}")
    # Of loopback, an address is enough
    others = [str(network) for network in asked if not network.is_loopback]
    reached = LOOPBACK if listen == EVERYWHERE else listen
    return [reached, *others]


def origins(listen: str, more: Sequence[str]) -> list[str]:
    """From which pages a browser may talk to it (cors_domains)."""
    names = ["localhost", LOOPBACK]
    if listen == EVERYWHERE:
        names += [name for name in own_networks() if name not in names]
    elif listen not in names:
        names.append(listen)
    own = [f"*://{name}{port}" for name in names for port in ("", ":*")]
    return [*own, *more]


def reserved_port(listen: str, wanted: int) -> tuple[int, Claim]:
    """The wanted port, or the first behind it that nobody uses.

    Until what comes with it is closed, no other played printer takes that port:
    Moonraker listens some seconds later only.
    """
    for port in range(wanted, min(wanted + 200, 65536)):
        claim = socket.socket(socket.AF_UNIX)
        try:
            # A name without a file, which ends with its process
            claim.bind(f"\0simplay-{port}")
            with socket.socket() as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind((listen, port))
        except OSError:
            claim.close()
            continue
        return port, claim
    raise AddressError(f"{listen} has no free port from {wanted} on")
