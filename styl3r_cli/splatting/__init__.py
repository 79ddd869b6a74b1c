"""The CPU splat renderer."""
