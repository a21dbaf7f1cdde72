"""Random walks: drawn printers, and what owners do with them in any order."""
