"""What tests and tools have in common about our modules."""
