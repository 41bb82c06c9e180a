"""The commands. A module reads the options of its command, calls the library, and prints the result."""
