"""The room of [dockable_probe]."""
