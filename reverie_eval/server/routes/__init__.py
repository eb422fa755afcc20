"""The routes of the API; each declares its parameters and replies, and calls one service."""
