"""The command line: thin; everything it does is also a function of the package."""
