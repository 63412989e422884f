"""Effects beyond the reference model, each a small class that plugs into one place of the step."""
