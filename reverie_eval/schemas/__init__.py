"""Wire formats, and nothing else: what files and replies look like."""
