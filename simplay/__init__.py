"""A simulated printer to play with: a page of its own, before a real Moonraker."""
