"""Klippy with the micro-controller program of its own: make test-firmware."""
