"""Klippy hosts for the tests: prepare them, install modules, run them."""
