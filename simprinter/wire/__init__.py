"""The serial protocol between a host and a micro-controller: bytes only."""
