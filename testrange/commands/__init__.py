"""The commands, one subject a file: what is asked for on the command line, and what is printed. The work is done elsewhere."""
