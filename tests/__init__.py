"""Tests of the modules on real klippy hosts and a simulated printer."""
