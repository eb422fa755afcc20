"""What the server decides: who may do what, what counts, and what leaves it."""
