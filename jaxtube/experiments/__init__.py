"""The command line: `cli.main` reads the words and runs one command."""
