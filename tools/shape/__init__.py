"""How much one has to read to know what a command does; see __main__."""
