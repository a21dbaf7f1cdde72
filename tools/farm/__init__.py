"""Many printers at once: what docs/print_farm.md needs to be tried."""
