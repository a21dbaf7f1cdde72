"""The room of [z_calibration]; module.py has its commands."""
