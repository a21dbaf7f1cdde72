"""A micro-controller: ticks, steps and pins, and no idea of a printer."""
