"""The server's rules: who may do what, what counts, and what is released."""
