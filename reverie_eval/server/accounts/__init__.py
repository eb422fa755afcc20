"""Teams, people, their tokens and data, and how they join."""
