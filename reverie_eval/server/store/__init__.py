"""Storage: the database, and uploads by their digest."""
