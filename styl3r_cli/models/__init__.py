"""The graphs that ship with the package."""
