"""Who may talk to the Moonraker of a played printer."""

from __future__ import annotations

import pytest

from simplay import network


def test_listening_address_decides_who_needs_no_password(monkeypatch):
    networks = {"127.0.0.1": "127.0.0.0/8", "10.1.2.3": "10.1.0.0/16"}
    networks = {
        address: network.ipaddress.IPv4Network(text)
        for address, text in networks.items()
    }
    monkeypatch.setattr(network, "own_networks", lambda: networks)
    assert network.trusted("127.0.0.1") == ["127.0.0.1"]
    assert network.trusted("10.1.2.3") == ["10.1.2.3", "10.1.0.0/16"]
    assert network.trusted("0.0.0.0") == ["127.0.0.1", "10.1.0.0/16"]
    with pytest.raises(network.AddressError, match=r"10\.1\.2\.3, 0\.0\.0\.0"):
        network.trusted("10.9.9.9")
    assert not [o for o in network.origins("127.0.0.1", []) if "10.1" in o]
    assert "*://10.1.2.3:*" in network.origins("10.1.2.3", [])
    assert "*://10.1.2.3" in network.origins("0.0.0.0", [])
