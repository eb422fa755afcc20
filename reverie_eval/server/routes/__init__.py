"""The routes: each declares what it takes and gives, and calls a service once."""
