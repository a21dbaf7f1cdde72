"""The room of [extra_probe NAME]; module.py has its commands."""
