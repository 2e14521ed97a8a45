"""`python -m particlerb`."""

from particlerb.cli import entry

entry()
