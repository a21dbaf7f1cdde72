"""Long runs over many faults and many printers."""
