"""Open splits, episode by episode: the walks, two results side by side, and playing oneself."""
