"""What owners reported, as files."""
