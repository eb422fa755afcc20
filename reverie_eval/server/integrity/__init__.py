"""What submissions have in common, for the organiser: evidence, not a verdict."""
