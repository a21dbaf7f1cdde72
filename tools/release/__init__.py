"""Whether a release may be tagged."""
